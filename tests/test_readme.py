"""What the README shows is what happens."""

import contextlib
import io
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def readme():
    return (ROOT / "README.md").read_text(encoding="utf-8")


def numbers(text):
    return [float(n) for n in re.findall(r"-?\d+\.\d+", text)]


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
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    linked = re.findall(r"\]\(([\w./]+)\)", readme)
    named = re.findall(r"`(ttus_opt/[\w./]+|formulations/)`", readme + page)
    assert min(len(linked), len(named)) > 5
    for path in linked + named:
        assert (ROOT / path).exists(), path


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
