"""Every block of the README, the first pages and the how-to pages runs as it is typed.

What a block is, its language says: ``shell`` and ``python`` run one after the other in
the folder that ``ttus-opt example`` writes, after the README's commands; one with a
title is written to that file first. ``sh`` and ``py`` need what is not here (an hour, a
device, ROS): their options are looked up, their Python is compiled; so are options in
``console``, which has what a command said. All else is text.
"""

import contextlib
import importlib
import importlib.util
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import warnings
from dataclasses import dataclass
from pathlib import Path

import pytest
import typer

from ttus_opt.cli.app import app
from ttus_opt.session.example_folder import COMMANDS

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
PAGES = [README, ROOT / "docs" / "index.md", *sorted(ROOT.glob("docs/how-to/*.md"))]

BLOCK = re.compile(r'^```([\w-]*)(?: title="(.+?)")?[^\n]*\n(.*?)^```', re.M | re.S)

#: Packages without which a page cannot run
NEEDS = {
    "message": "pcodec",
    "live": "msgspec",
    "viewer": "viser",
    "own-regulariser": "cvxpy",
}


@dataclass(frozen=True)
class Block:
    language: str
    title: str
    text: str


def blocks(page):
    return [Block(*found) for found in BLOCK.findall(page.read_text(encoding="utf-8"))]


def commands(text):
    """Lines of a shell block that call ttus-opt, as words."""
    lines = text.replace("\\\n", " ").splitlines()
    words = (shlex.split(line, comments=True) for line in lines)
    return [found[1:] for found in words if found[:1] == ["ttus-opt"]]


def require_known(words):
    """Find the command and its options, without running it."""
    found = typer.main.get_command(app)
    while hasattr(found, "commands"):
        found = found.commands[words[0]]
        words = words[1:]
    known = {name for p in found.params for name in (*p.opts, *p.secondary_opts)}
    for word in words:
        # of -0.5,0.5 and --sector=-60,60 the first is a value
        name = word.partition("=")[0]
        if re.match(r"--?[a-z]", name):
            assert name in known, f"{found.name} has no {name}"


def names(pages):
    return [page.stem for page in pages]


@pytest.mark.parametrize("page", PAGES, ids=names(PAGES))
def test_blocks_are_what_they_say(page):
    for block in blocks(page):
        if block.language in ("shell", "sh"):
            for words in commands(block.text):
                require_known(words)
        elif block.language in ("python", "py"):
            compile(block.text, f"{page.name}: {block.text.splitlines()[0]}", "exec")
        elif block.language == "console":  # with what the commands say
            typed = re.findall(r"^\$ (.*)", block.text, re.M)
            for words in commands("\n".join(typed)):
                require_known(words)
        else:  # what is to be typed says so
            assert not commands(block.text), block.text
            assert not re.search("^import ", block.text, re.M), block.text


def test_the_script_of_the_example_has_the_commands_of_the_readme():
    assert COMMANDS in [block.text for block in blocks(README)]


class Shell:
    """Runs blocks in a folder, where ``ttus-opt`` is the package under test."""

    def __init__(self, folder, bin_folder):
        self.folder = folder
        self._names = {"__name__": "page"}
        own = bin_folder / "ttus-opt"
        own.write_text(f'#!/bin/sh\nexec "{sys.executable}" -P -m ttus_opt "$@"\n')
        own.chmod(0o755)
        self._environment = {
            **os.environ,
            "PATH": f"{bin_folder}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT),
        }

    def run(self, block):
        if block.title:
            (self.folder / block.title).write_text(block.text, encoding="utf-8")
        if block.language == "shell":
            self._typed(block.text)
        elif block.language == "python":
            self._executed(block.text)

    def _typed(self, text):
        where = self.folder / ".where"
        done = subprocess.run(
            ["bash", "-ec", f'{text}\npwd > "$0"', where],
            cwd=self.folder,
            env=self._environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{text}\n{done.stdout}\n{done.stderr}"
        self.folder = Path(where.read_text().strip())  # it may have been left by cd
        where.unlink()

    def _executed(self, text):
        with (
            contextlib.chdir(self.folder),
            warnings.catch_warnings(),
            pytest.MonkeyPatch.context() as patch,
        ):
            warnings.simplefilter("default")
            patch.syspath_prepend(self.folder)
            exec(compile(text, text.splitlines()[0], "exec"), self._names)


@pytest.fixture(scope="module")
def bin_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("bin")


@pytest.fixture(scope="module")
def tried(tmp_path_factory, bin_folder):
    """The folder after the README's own blocks, which run for this."""
    shell = Shell(tmp_path_factory.mktemp("readme"), bin_folder)
    for block in blocks(README):
        shell.run(block)
    return shell.folder


@pytest.mark.slow
def test_the_readme_leaves_what_it_promises(tried):
    for name in ("surface.png", "field.nc", "path.png", "force.png", "rendered.csv"):
        assert (tried / name).stat().st_size > 1000
    assert (tried / "results" / "report.html").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES[1:], ids=names(PAGES[1:]))
def test_every_block_runs_as_it_is_typed(page, tried, bin_folder, tmp_path):
    needed = NEEDS.get(page.stem, "ttus_opt")
    if importlib.util.find_spec(needed) is None:
        pytest.skip(f"needs {needed}")
    runs = [b for b in blocks(page) if b.title or b.language in ("shell", "python")]
    shell = Shell(shutil.copytree(tried, tmp_path / "try"), bin_folder)
    for block in runs:
        shell.run(block)


#: Pages that are over in seconds
QUICK = [ROOT / "docs" / "how-to" / f"{n}.md" for n in ("one-clock", "voxel-order")]


@pytest.mark.parametrize("page", QUICK, ids=names(QUICK))
def test_quick_pages(page, tmp_path):
    """Their Python, which needs no files; `slow` has the rest."""
    shell = Shell(tmp_path, tmp_path)
    for block in blocks(page):
        if block.language == "python":
            shell.run(block)


DOCS = Path(__file__).parents[1] / "docs"


@pytest.mark.slow
def test_the_transcript_is_what_the_commands_say(tmp_path, monkeypatch):
    """Run anew; the same words, numbers aside, which differ by machine and version."""
    pytest.importorskip("rosbags", reason="needs ttus-opt[sensors]")
    monkeypatch.setattr(sys, "path", [str(DOCS), *sys.path])
    devices = importlib.import_module("devices")
    monkeypatch.chdir(tmp_path)
    lines = "\n".join([devices.HEAD, *devices.transcript(), ""])
    assert words(lines) == words(devices.PAGE.read_text(encoding="utf-8"))


def words(text):
    """The text without numbers and the layout that follows from their widths."""
    return re.sub(r"\s+", " ", re.sub(r"[-+]?\d[\d,.]*(e[-+]?\d+)?", "#", text))


@pytest.fixture(scope="module")
def readme():
    return (ROOT / "README.md").read_text(encoding="utf-8")


def numbers(text):
    return [float(n) for n in re.findall(r"-?\d+\.\d+", text)]


@pytest.mark.slow
def test_the_python_lines_print_what_is_said(readme):
    found = re.search(r"```python\n(.*?)```\n\nprints\n\n```\n(.*?)\n```", readme, re.S)
    code, said = found.groups()
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "README.md", "exec"), {})
    assert printed.getvalue().startswith("SOLVED, unseen pushes: ")
    (error, *force), (said_error, *said_force) = map(
        numbers, (printed.getvalue(), said)
    )
    # to the digits that are printed, give or take one
    assert error == pytest.approx(said_error, abs=0.011)
    assert force == pytest.approx(said_force, abs=0.11)


def test_files_and_folders_it_names_are_there(readme):
    linked = re.findall(r"\]\(([\w./]+)\)", readme)
    assert len(linked) > 5
    for path in linked:
        assert (ROOT / path).exists(), path


#: Pages that name files of the package, and how they do
NAMING = ["CONTRIBUTING.md", "docs/architecture.md", "docs/comparators.md"]
FILE = re.compile(
    r"`((?:ttus_opt|tests|formulations|benchmarks|examples)/[\w./]*|[\w/]+\.py)`"
)


@pytest.mark.parametrize(
    "page", [ROOT / p for p in NAMING] + PAGES, ids=lambda p: p.stem
)
def test_files_of_the_package_that_a_page_names_are_there(page):
    """The second of a row or paragraph may be named from the folder of the first."""
    for part in re.split(r"\n(?=[\n|#-])", page.read_text(encoding="utf-8")):
        folders = []
        for path in FILE.findall(part):
            if "/" in path or folders:  # else it may be the reader's own
                near = [ROOT, ROOT / "ttus_opt", *folders]
                found = [folder / path for folder in near if (folder / path).exists()]
                assert found, path
                folders += [one if one.is_dir() else one.parent for one in found]


def test_the_picture_is_small():
    assert (ROOT / "docs" / "overview.png").stat().st_size < 100_000


def test_a_citation_names_this_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    cited = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    for key, value in (
        ("version", project["version"]),
        ("license", project["license"]),
        ("  - name", project["authors"][0]["name"]),
    ):
        assert f"\n{key}: {value}\n" in cited


def test_a_package_index_gets_no_link_that_leads_nowhere(readme):
    hooks = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]
    made = hooks["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]
    for one in made:
        readme = re.sub(one["pattern"], one["replacement"], readme)
    links = re.findall(r"\]\(([^)]*)\)", readme)
    assert not [link for link in links if not link.startswith("http")]
    assert "A first hour goes" in readme and "```python\nimport ttus_opt" in readme
