"""Find the classes of a package with one file per class, such as `problem.terms`."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from types import ModuleType


def members(package: ModuleType) -> dict[str, type]:
    """The public classes of a package's files by name; imports all files."""
    return {kind.__name__: kind for kind in _classes(package)}


def member(package: ModuleType, name: str) -> type:
    """The class of a given name, for a package's ``__getattr__``.

    Raises:
        AttributeError: There is no class of that name.
    """
    if name[:1].isupper():  # classes only: Python itself finds submodules
        for kind in _classes(package):
            if kind.__name__ == name:
                return kind
    raise AttributeError(f"module {package.__name__!r} has no attribute {name!r}")


def _classes(package: ModuleType) -> Iterator[type]:
    for info in pkgutil.iter_modules(package.__path__):
        if info.ispkg:
            continue
        module = importlib.import_module(f"{package.__name__}.{info.name}")
        for kind in vars(module).values():
            own = inspect.isclass(kind) and kind.__module__ == module.__name__
            if own and not kind.__name__.startswith("_"):
                yield kind
