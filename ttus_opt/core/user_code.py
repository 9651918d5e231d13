"""Load a user's own code and report its exceptions in one line with file and line."""

from __future__ import annotations

import contextlib
import difflib
import importlib.util
import inspect
import sysconfig
import traceback
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any

from ttus_opt.core.errors import InputError, TtusError
from ttus_opt.core.formulation_files import shelf

_OWN = str(Path(__file__).resolve().parents[1])


@contextlib.contextmanager
def user_errors(what: str) -> Iterator[None]:
    """Report an exception in a user's code in one sentence with its file and line.

    Args:
        what: Name of the code, at the beginning of the sentence.

    Raises:
        InputError: A user's file raised an exception, which becomes the cause, without
            the frames of this package. Exceptions from elsewhere pass unchanged.
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
        raised = f"{type(error).__name__}: {words}" if words else type(error).__name__
        raise InputError(
            f"{what} raised {raised} ({file}, line {line})"
        ) from error.with_traceback(frames)


def module_of_file(path: Path, kind: str) -> ModuleType:
    """Run a user's Python file and return its module.

    Args:
        path: The file.
        kind: What it contains, for messages: "formulation", "solver".

    Raises:
        InputError: The file is missing or raises an exception.
    """
    if not path.exists():
        raise InputError(f"{kind} file not found: {path}: check the path")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path} cannot be loaded as a Python file")
    module = importlib.util.module_from_spec(spec)
    with user_errors(f"{kind} file {path}"):
        spec.loader.exec_module(module)
    return module


def unknown_name(kind: str, name: str, known: Collection[str]) -> InputError:
    """The error for an unknown name; its message lists the most similar known names."""
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.4)
    return InputError(
        f"unknown {kind} {name!r}, {'did you mean' if near else 'there are'} "
        f"{', '.join(near or known)}? A file of your own ends in .py"
    )


def defined_at(function: Callable[..., Any]) -> str:
    """Where a user's function is defined, to append to its name; else ""."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    if code is None or not _is_users(code.co_filename):
        return ""
    return f" ({code.co_filename}, line {code.co_firstlineno})"


def _place(error: BaseException) -> tuple[str, int, TracebackType | None] | None:
    """File and line of the innermost frame in a user's file, and the frames below."""
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
    """Whether a file belongs neither to Python nor to any installed package."""
    if filename.startswith("<") and not filename.startswith("<ipython"):
        return filename == "<stdin>"
    paths = sysconfig.get_paths()
    packages = [paths[key] for key in ("stdlib", "platstdlib", "purelib", "platlib")]
    shelves = (str(Path(folder).resolve()) for folder in shelf().__path__)
    roots = [_OWN, *packages, *shelves]
    path = Path(filename).resolve()
    return not any(path.is_relative_to(root) for root in roots)
