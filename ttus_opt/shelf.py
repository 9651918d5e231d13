"""Members of a shelf, a package of one file per class, found by their name."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from types import ModuleType


def members(package: ModuleType) -> dict[str, type]:
    """Public classes of a package's files, by name; all of them are imported.

    Args:
        package: For instance ``ttus_opt.terms``.
    """
    return {kind.__name__: kind for kind in _classes(package)}


def member(package: ModuleType, name: str) -> type:
    """One of them, for a package's ``__getattr__``.

    Raises:
        AttributeError: There is none of that name.
    """
    if name[:1].isupper():  # files and private names are looked for elsewhere
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
