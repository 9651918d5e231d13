"""Exceptions of a user's own code, told in one sentence with its file and line."""

from __future__ import annotations

import contextlib
import inspect
import sysconfig
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from ttus_opt.errors import InputError, TtusError
from ttus_opt.formulation_files import shelf

_OWN = str(Path(__file__).resolve().parent)


@contextlib.contextmanager
def told_by_line(what: str) -> Iterator[None]:
    """Turn what a user's code raises into one sentence.

    Args:
        what: What the code was asked for, to begin the sentence with.

    Raises:
        InputError: An exception came from a user's file; it says which line, and has
            the exception as its cause, without the frames of this package. What is no
            user's fault passes as it is.
    """
    try:
        yield
    except TtusError:
        raise
    except (Exception, SystemExit) as error:
        place = _place(error)
        if place is None:
            raise
        file, line, frames = place
        words = error.msg if isinstance(error, SyntaxError) else str(error)
        told = f"{type(error).__name__}: {words}" if words else type(error).__name__
        raise InputError(
            f"{what} raised {told} ({file}, line {line})"
        ) from error.with_traceback(frames)


def defined_at(function: Callable[..., Any]) -> str:
    """Where a user's function is defined, to put behind a name; "" for our own."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    if code is None or not _is_users(code.co_filename):
        return ""
    return f" ({code.co_filename}, line {code.co_firstlineno})"


def _place(error: BaseException) -> tuple[str, int, TracebackType | None] | None:
    """File and line of the innermost frame of a user, and the frames from there on."""
    if isinstance(error, SyntaxError) and error.filename and error.lineno:
        if _is_users(error.filename):
            return error.filename, error.lineno, None
        return None
    found = None
    frames = error.__traceback__
    while frames is not None:
        (frame,) = traceback.extract_tb(frames, limit=1)
        if _is_users(frame.filename):
            found = frame.filename, frame.lineno or 0, frames
        frames = frames.tb_next
    return found


def _is_users(filename: str) -> bool:
    """Whether a file is neither Python's, nor a package's, nor this package's."""
    if filename.startswith("<") and not filename.startswith("<ipython"):
        return filename == "<stdin>"
    paths = sysconfig.get_paths()
    packages = [paths[key] for key in ("stdlib", "platstdlib", "purelib", "platlib")]
    shelves = (str(Path(folder).resolve()) for folder in shelf().__path__)
    roots = [_OWN, *packages, *shelves]
    path = Path(filename).resolve()
    return not any(path.is_relative_to(root) for root in roots)
