"""Plug-ins found by name or path: classes of a package, formulations, a user's files.

In a checkout the formulations are in ``formulations/`` beside the package, in an
installed wheel in ``ttus_opt/formulations/``. Both are imported as
``ttus_opt.formulations``, and also as ``formulations`` unless a user's own file or
folder has that name. What a user's code raises is told in one line with file and line.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import importlib
import importlib.util
import inspect
import pkgutil
import sys
import sysconfig
import traceback
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any

from ttus_opt.core.errors import FileError, InputError, TtusError

_PACKAGE = Path(__file__).resolve().parents[1]

NAME, SHORT = "ttus_opt.formulations", "formulations"


def classes_of(package: ModuleType) -> dict[str, type]:
    """The public classes of a package's files by name; imports all files."""
    return {kind.__name__: kind for kind in _classes(package)}


def finders(name: str) -> tuple[Callable[[str], type], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package: the classes of its files.

    The former raises an AttributeError where there is no class of a name.
    """
    package = sys.modules[name]

    def find(wanted: str) -> type:
        if wanted[:1].isupper():  # classes only: Python itself finds submodules
            for kind in _classes(package):
                if kind.__name__ == wanted:
                    return kind
        raise AttributeError(f"module {name!r} has no attribute {wanted!r}")

    return find, lambda: sorted(classes_of(package))


def _classes(package: ModuleType) -> Iterator[type]:
    for info in pkgutil.iter_modules(package.__path__):
        if info.ispkg:
            continue
        module = importlib.import_module(f"{package.__name__}.{info.name}")
        for kind in vars(module).values():
            defined = inspect.isclass(kind) and kind.__module__ == module.__name__
            if defined and not kind.__name__.startswith("_"):
                yield kind


@functools.cache
def formulations() -> ModuleType:
    """The package that contains the formulations.

    Raises:
        FileError: It is in neither place.
    """
    if NAME in sys.modules:
        return sys.modules[NAME]
    for folder in (_PACKAGE / SHORT, _PACKAGE.parent / SHORT):
        first = folder / "__init__.py"
        if not first.is_file():
            continue
        spec = importlib.util.spec_from_file_location(
            NAME, first, submodule_search_locations=[str(folder)]
        )
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[NAME] = module
        spec.loader.exec_module(module)
        if importlib.util.find_spec(SHORT) is None:
            sys.modules[SHORT] = module
        return module
    raise FileError(
        f"the formulations are not next to {_PACKAGE}: install ttus-opt again, or run "
        "from a whole checkout"
    )


def formulation_module(name: str) -> ModuleType:
    """Import a formulation by the name of its file, without the suffix."""
    return importlib.import_module(f"{formulations().__name__}.{name}")


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


@functools.lru_cache
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
    place = None
    frames = error.__traceback__
    while frames is not None:
        (frame,) = traceback.extract_tb(frames, limit=1)
        if _is_users(frame.filename):
            place = frame.filename, frame.lineno or 0, frames
        frames = frames.tb_next
    return place


def _is_users(filename: str) -> bool:
    """Whether a file belongs neither to Python nor to any installed package."""
    if filename.startswith("<") and not filename.startswith("<ipython"):
        return filename == "<stdin>"
    paths = sysconfig.get_paths()
    packages = [paths[key] for key in ("stdlib", "platstdlib", "purelib", "platlib")]
    bundled = (str(Path(folder).resolve()) for folder in formulations().__path__)
    roots = [str(_PACKAGE), *packages, *bundled]
    path = Path(filename).resolve()
    return not any(path.is_relative_to(root) for root in roots)
