"""How this package starts Python programs of its own.

``python -m`` would look for every module in the current folder first: a ``numba.py``
among downloaded data would be executed.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

#: The environment's word for ``python -P``
SAFE = "PYTHONSAFEPATH"


def python_module(module: str, *arguments: str) -> list[str]:
    """The command of a module, found on the import path and not in this folder."""
    return [sys.executable, "-P", "-m", module, *arguments]


def environment() -> dict[str, str]:
    """This process's environment, with its import path for a child.

    The current folder comes last: a script's own classes are found there, but no
    installed package is replaced by a file of the same name.
    """
    here = str(Path.cwd())
    paths = [*(p for p in sys.path if p not in ("", here)), here]
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(dict.fromkeys(paths)),
        SAFE: "1",  # for children of the child
    }


@contextlib.contextmanager
def safe_path() -> Iterator[None]:
    """Let other libraries start their Python programs as `python_module` does."""
    before = os.environ.get(SAFE)
    os.environ[SAFE] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE]
        else:
            os.environ[SAFE] = before
