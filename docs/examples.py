"""Runs the Python lines of the how-to pages; `make docs` does so before it builds.

Blocks of a page that begin with ```python run one after the other, in a folder of their
own; one with a title is written to that file first. Blocks that need what is not here
(ROS) begin with ```py and are only compiled.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
import tempfile
from pathlib import Path

PAGES = Path(__file__).parent / "how-to"

BLOCK = re.compile(r'^```(python|py)(?: title="(.+?)")?\n(.*?)^```', re.M | re.S)


def run(page: Path) -> str:
    """Run a page's blocks; what they print."""
    printed, names = io.StringIO(), {"__name__": page.stem}
    for kind, title, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        code = compile(text, f"{page.name}: {title or text.splitlines()[0]}", "exec")
        if title:
            Path(title).write_text(text, encoding="utf-8")
        if kind == "python":
            with contextlib.redirect_stdout(printed):
                exec(code, names)
    return printed.getvalue()


def main() -> None:
    """Run all pages."""
    for page in sorted(PAGES.glob("*.md")):
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            sys.path.insert(0, os.getcwd())
            try:
                print(f"{page.name}\n{run(page)}")
            finally:
                sys.path.pop(0)


if __name__ == "__main__":
    main()
