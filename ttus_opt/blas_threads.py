"""Dense algebra by one thread, where matrices are small.

OpenBLAS wakes its threads even for a matrix of a hundred rows, and they keep every
processor busy while they wait for the next one: choosing weights then takes several
times the processor time, and longer. numpy and scipy bring a library each. Others than
those of their wheels are left alone. (threadpoolctl knows more of them, but would be
one more dependency.)
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

import numpy
import scipy


@dataclass(frozen=True)
class OpenBlas:
    """The number of threads of one library.

    Attributes:
        threads: Returns it.
        use: Sets it.
    """

    threads: Callable[[], int]
    use: Callable[[int], None]

    @classmethod
    def of(cls, package: ModuleType) -> list[OpenBlas]:
        """Those in a package's wheel."""
        place = Path(str(package.__file__)).parent
        folders = place.with_name(f"{package.__name__}.libs"), place / ".dylibs"
        return [
            found
            for folder in folders
            for path in sorted(folder.glob("*openblas*"))
            if (found := cls._at(path)) is not None
        ]

    @classmethod
    def _at(cls, path: Path) -> OpenBlas | None:
        try:
            library = ctypes.CDLL(str(path))
        except OSError:
            return None
        for suffix in ("64_", ""):
            names = (f"scipy_openblas_{act}_num_threads{suffix}" for act in NAMED)
            both = [getattr(library, name, None) for name in names]
            if None not in both:
                return cls(*both)  # type: ignore[arg-type]
        return None


#: What the functions of a library do, in the order of `OpenBlas`
NAMED = ("get", "set")


@functools.cache
def libraries() -> tuple[OpenBlas, ...]:
    """Those of numpy and scipy."""
    return (*OpenBlas.of(numpy), *OpenBlas.of(scipy))


@dataclass
class _Users:
    """Who wants one thread: the number is that of the process, not of a thread."""

    count: int = 0
    before: list[int] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)


_users = _Users()


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let one thread do numpy's and scipy's dense algebra; also as a decorator.

    The number of threads before is restored when the last user leaves.
    """
    with _users.lock:
        if not _users.count:
            _users.before = [library.threads() for library in libraries()]
            for library in libraries():
                library.use(1)
        _users.count += 1
    try:
        yield
    finally:
        with _users.lock:
            _users.count -= 1
            if not _users.count:
                for library, before in zip(libraries(), _users.before, strict=True):
                    library.use(before)
