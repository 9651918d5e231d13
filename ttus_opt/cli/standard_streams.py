"""``-`` as a file: what comes in on stdin, and what goes out on stdout.

A reader wants a file whose name says what it holds, so stdin is kept in one for as long
as the command runs, and a result is copied from one. What a command says goes to
stderr where its result is on stdout.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ttus_opt.cli.console import words_beside
from ttus_opt.core.errors import InputError, TtusError

#: The file that stands for stdin or stdout
DASH = Path("-")

#: How files of a kind begin; all else is a table as text
BEGINNINGS = {
    b"ply": ".ply",
    b"# .PCD": ".pcd",
    b"\x89HDF": ".nc",
    b"\x89PNG": ".png",
    b"\x93NUMPY": ".npy",
    b"NDIM": ".mha",
    b"ObjectType": ".mha",
    b"{": ".json",
    b"solid": ".stl",
}


@contextlib.contextmanager
def standard_streams(
    given: dict[str, Any], *, folder: bool, written: Sequence[str], json: bool
) -> Iterator[None]:
    """Put files in the place of ``-`` among a command's options.

    Args:
        given: Options by name, changed in place. ``output`` is written, others read.
        folder: Whether the output is a folder, which no stream can be.
        written: Options that are written too, as pictures are, which no stream can be.
        json: Whether facts go to stdout.

    Raises:
        InputError: An option cannot be a stream, or two want the same.
    """
    reads = [n for n, v in given.items() if n != "output" and DASH in _listed(v)]
    reads += [n for n in reads if isinstance(given[n], list) and len(given[n]) > 1]
    writes = given.get("output") == DASH
    if not reads and not writes:
        yield
        return
    if len(reads) > 1:
        raise InputError("- stands for stdin, which can be read once: name files")
    if beside := [n for n in reads if "picture" in n or n in written]:
        option = "--" + beside[0].replace("_", "-")
        raise InputError(f"only --output can go to stdout: name a file for {option}")
    if writes and folder:
        raise InputError("--output is a folder here, which cannot go to stdout")
    if writes and json:
        raise InputError("--output - and --json both write to stdout: choose one")
    with tempfile.TemporaryDirectory(prefix="ttus-opt-") as place:
        for name in reads:
            file = _kept(Path(place))
            given[name] = [file] if isinstance(given[name], list) else file
        result = Path(place) / "stdout"
        if writes:
            given["output"] = result
        with words_beside(writes, f"{place}/"):
            try:
                yield
            except TtusError as error:
                error.args = (str(error).replace(f"{place}/", ""),)
                raise
        if writes and result.exists():
            with result.open("rb") as stream:
                shutil.copyfileobj(stream, sys.stdout.buffer)
            sys.stdout.flush()


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _kept(place: Path) -> Path:
    """All of stdin as a file whose suffix says what it holds."""
    content = sys.stdin.buffer.read()
    suffixes = (s for begin, s in BEGINNINGS.items() if content.startswith(begin))
    file = place / f"stdin{next(suffixes, '.csv')}"
    file.write_bytes(content)
    return file
