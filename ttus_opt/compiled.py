"""Compiled functions: numba with a cache that old code cannot haunt.

numba keeps machine code under the content of the file a function stands in, yet links
in functions of other files: after an upgrade that changes only those, it would go on
running the old ones, against arrays laid out anew. Here the cache lies in a folder
named after all files that hold compiled functions, so that a change in any of them
compiles all of them again.
"""

from __future__ import annotations

import functools
import os
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numba

_HERE = Path(__file__).parent


def compiled(**options: Any) -> Any:
    """Decorator: compile on first use and keep the machine code.

    Args:
        options: numba's own (``nogil``, ``inline``, ``fastmath``, ``error_model``).

    Returns:
        A decorator like ``numba.njit``.
    """

    def decorate(function: Any) -> Any:
        # numba reads the folder when a function is decorated; others keep theirs
        before = numba.config.CACHE_DIR
        if not before:  # a folder the user has set is respected
            numba.config.CACHE_DIR = str(_cache_folder())
        try:
            return numba.njit(cache=True, **options)(function)
        finally:
            numba.config.CACHE_DIR = before

    return decorate


def source_stamp(folder: Path) -> str:
    """Checksum of all modules below a folder that hold compiled functions."""
    stamp = 0
    for path in sorted(folder.rglob("*.py")):
        content = path.read_bytes()
        if b"import compiled" in content or path == Path(__file__):
            stamp = zlib.crc32(path.name.encode() + content, stamp)
    return f"{stamp:08x}"


@functools.cache
def _cache_folder() -> Path:
    """Beside the package's own bytecode, or in the user's cache where that is fixed."""
    name = f"compiled-{source_stamp(_HERE)}"
    beside = _HERE / "__pycache__"
    if os.access(beside if beside.exists() else _HERE, os.W_OK):
        return beside / name
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    if os.access(Path.home(), os.W_OK):
        return Path(home) / "ttus_opt" / name
    return Path(tempfile.gettempdir()) / f"ttus_opt-{os.getuid()}" / name
