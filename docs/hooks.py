"""Content that the site takes from elsewhere in the repository, and its checks.

- notebooks/ and MathJax are put among the site's files; notebooks are run anew when
  they or the package changed;
- ``{{ modules }}`` becomes the list of modules with the first line of their docstrings,
  bold where pyproject.toml lists them as offered to other rooms;
- every module that `method/` names must exist, every public name must be on `api.md`.

Warnings of these checks end the build, as `mkdocs build --strict` does for any.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.resources
import logging
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "ttus_opt"

#: Pages that are a section of their own
ALONE = (
    "index.md",
    "api.md",
    "modules.md",
    "benchmark.md",
    "comparators.md",
    "experiment/report.md",
)

_log = logging.getLogger("mkdocs.hooks.ttus_opt")


def on_config(config: Any) -> Any:
    """Outputs of notebooks belong to a state of the package."""
    digest = hashlib.sha256()
    for folder in (PACKAGE, ROOT / "formulations"):
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.read_bytes())
    notebooks = config.plugins["mkdocs-jupyter"].config
    outputs = digest.hexdigest()[:16] if notebooks["execute"] else "none"
    notebooks["cache_dir"] = f"{notebooks['cache_dir']}/{outputs}"
    return config


@event_priority(100)  # before the notebook plugin looks for notebooks
def on_files(files: Files, config: Any) -> Files:
    """Add the notebooks and MathJax."""
    for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
        uri = f"notebooks/{notebook.name}"
        files.append(File(uri, str(ROOT), config.site_dir, config.use_directory_urls))
    mathjax = importlib.resources.files("mathjax") / "static/mathjax"
    for name, uri in (
        ("es5/tex-svg-full.js", "javascripts/tex-svg-full.js"),
        ("LICENSE", "javascripts/tex-svg-full.LICENSE.txt"),
    ):
        path = str(mathjax / name)
        files.append(File.generated(config, uri, abs_src_path=path))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Fill in what is written elsewhere, and check names."""
    uri = page.file.src_uri
    if uri in ALONE:  # no neighbours in the menu: the room is for equations and tables
        page.meta.setdefault("hide", []).append("navigation")
    markdown = markdown.replace("{{ modules }}", _module_list())
    if uri.startswith("method/"):
        markdown = re.sub(r"`([a-z_]+(?:\.[a-z_]+)*)`", _module_link, markdown)
    if uri == "api.md":
        _check_public_names(markdown)
    return markdown


def _modules() -> Iterator[tuple[str, str]]:
    """Dotted names below the package, and the first line of their docstrings."""
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        if parts[-1].startswith("__") and parts[-1] != "__init__":
            continue
        name = ".".join(p for p in parts if p != "__init__")
        doc = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        yield name, doc.split("\n", 1)[0]


def _module_list() -> str:
    """Rooms with their modules, then the modules beside the rooms."""
    rooms: dict[str, list[str]] = {}
    offered = _offered()
    titles = {"": "Beside the rooms"}
    for name, summary in _modules():
        first, _, rest = name.partition(".")
        room = first if (PACKAGE / first).is_dir() else ""
        if room and not rest:
            titles[room] = f"{room}\n\n{summary}"
        elif name:
            text = summary.replace("|", "\\|")
            shown = f"**`{name}`**" if name in offered else f"`{name}`"
            line = f'| <span id="{name}"></span>{shown} | {text} |'
            rooms.setdefault(room, []).append(line)
    alone = rooms.pop("", [])
    parts = [(titles[room], lines) for room, lines in sorted(rooms.items())]
    parts.append((titles[""], alone))
    head = "| module | what it holds |\n|---|---|\n"
    return "\n\n".join(f"## {t}\n\n{head}" + "\n".join(rows) for t, rows in parts)


def _offered() -> set[str]:
    """Modules that other rooms may import, from the contract in pyproject.toml."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    contracts = tomllib.loads(text)["tool"]["importlinter"]["contracts"]
    (rooms,) = (c for c in contracts if c["type"] == "protected")
    return {line.split(f"{PACKAGE.name}.")[1] for line in rooms["ignore_imports"]}


def _module_link(match: re.Match[str]) -> str:
    """A link where the name is a module's; a warning where it should be and is not."""
    name = match[1]
    parts = name.split(".")
    base = PACKAGE.joinpath(*parts)
    if base.with_suffix(".py").is_file():
        return f"[`{name}`](../modules.md#{name})"
    if base.is_dir():
        return f"[`{name}`](../modules.md#{parts[0]})"
    if len(parts) > 1 and parts[0] != PACKAGE.name:
        _log.warning("the method names %s, there is no such module", name)
    return match[0]


def _check_public_names(markdown: str) -> None:
    import ttus_opt

    # a module is shown under its own name, such as ttus_opt.report.plots
    shown = set(re.findall(r"^::: ttus_opt\.(?:\w+\.)*(\w+)$", markdown, re.M))
    for name in sorted(set(ttus_opt.__all__) - shown):
        _log.warning("api.md does not show the public name %s", name)
