"""Threads: parallel work on many items or parts of one, and dense algebra by one.

A BLAS wakes its threads even for a matrix of a hundred rows, and they keep every
processor busy while they wait for the next one: choosing weights then takes several
times the processor time, and longer.
"""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, TypeVar

Result = TypeVar("Result")

#: Largest number of cores that share one item: memory bandwidth limits them [–]
MOST_PARTS = 8

_here = threading.local()


def usable_cores() -> int:
    """Cores this process may use, at least 1 [–]; on macOS and Windows all cores."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def side_by_side(work: Callable[..., Result], *things: Iterable[Any]) -> list[Result]:
    """Like `map`, with one thread per core: for compiled work that releases the GIL.

    Args:
        work: Called with one element of each iterable.
        things: Iterables of equal length.

    Returns:
        The results, in order.
    """
    with ThreadPoolExecutor(usable_cores(), initializer=_keep_whole) as pool:
        return list(pool.map(work, *things))


def parts_of(size: int, large: int) -> int:
    """The number of parts to divide an item into: one per core, or 1 if it is small.

    It is also 1 in a thread that works on items `side_by_side`.

    Args:
        size: Size of the item.
        large: Size from which the item is divided.
    """
    if size < large or getattr(_here, "keeps_whole", False):
        return 1
    return min(usable_cores(), MOST_PARTS)


def in_parts(work: Callable[[tuple[int, int]], object], parts: int) -> None:
    """Work on all parts of an item in parallel: for work that releases the GIL.

    Args:
        work: Called with (number of the part, number of parts).
        parts: Number of parts; the calling thread does the first.
    """
    if parts == 1:  # also on small grids, where a microsecond counts
        work((0, 1))
        return
    others = [_helpers().submit(work, (n, parts)) for n in range(1, parts)]
    try:
        work((0, parts))
    finally:
        wait(others)  # even if this part is interrupted: they write to shared arrays
    for other in others:
        other.result()


@functools.cache
def _helpers() -> ThreadPoolExecutor:
    """The worker threads, kept because starting them takes as long as the work."""
    return ThreadPoolExecutor(MOST_PARTS - 1, "ttus_opt", initializer=_keep_whole)


if hasattr(os, "register_at_fork"):  # a forked process has none of its parent's threads
    os.register_at_fork(after_in_child=_helpers.cache_clear)


def _keep_whole() -> None:
    _here.keeps_whole = True


@functools.cache
def _libraries() -> Any:
    """The BLAS libraries of numpy and scipy, which are searched for once."""
    import scipy.linalg  # noqa: F401  # loads its own
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


#: Who wants one thread now; the number of threads is the process's, not a thread's
_USERS: list[Any] = []
_COUNTING = threading.Lock()


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let one thread do numpy's and scipy's dense algebra; also as a decorator.

    The number of threads before is restored when the last user leaves.
    """
    with _COUNTING:
        _USERS.append(_USERS[0] if _USERS else _libraries().limit(limits=1))
    try:
        yield
    finally:
        with _COUNTING:
            limit = _USERS.pop()
            if not _USERS:
                limit.restore_original_limits()
