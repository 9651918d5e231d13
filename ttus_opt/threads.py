"""Work side by side on the processor's cores: on many things, or on parts of one."""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, TypeVar

Result = TypeVar("Result")

#: Most cores that share one thing: its memory is what they wait for [–]
MOST_PARTS = 8

_here = threading.local()


def usable_cores() -> int:
    """Cores this process may use, at least 1 [–].

    Where a system does not tell (macOS, Windows) those that there are.
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def side_by_side(work: Callable[..., Result], *things: Iterable[Any]) -> list[Result]:
    """Like `map`, by a thread a core: for compiled work that lets others run.

    Args:
        work: Called with one of each of the things.
        things: Of equal length.

    Returns:
        What it gave, in their order.
    """
    with ThreadPoolExecutor(usable_cores(), initializer=_keep_whole) as pool:
        return list(pool.map(work, *things))


def parts_of(size: int, large: int) -> int:
    """In how many parts a thing is worked on: one a core, or one where it is small.

    One, too, where other things are worked on `side_by_side`.

    Args:
        size: Of the thing.
        large: From which size on it is large.
    """
    if size < large or getattr(_here, "keeps_whole", False):
        return 1
    return min(usable_cores(), MOST_PARTS)


def in_parts(work: Callable[[tuple[int, int]], object], parts: int) -> None:
    """Do a thing's parts at the same time: for compiled work that lets others run.

    Args:
        work: Called with each part, (which, of how many).
        parts: How many; one is done here.
    """
    others = [_helpers().submit(work, (n, parts)) for n in range(1, parts)]
    try:
        work((0, parts))
    finally:
        wait(others)  # also where this part is interrupted: they write to its arrays
    for other in others:
        other.result()


@functools.cache
def _helpers() -> ThreadPoolExecutor:
    """Threads beside the caller's, kept: to start them takes as long as the work."""
    return ThreadPoolExecutor(MOST_PARTS - 1, "ttus_opt", initializer=_keep_whole)


if hasattr(os, "register_at_fork"):  # a forked process has none of its parent's threads
    os.register_at_fork(after_in_child=_helpers.cache_clear)


def _keep_whole() -> None:
    _here.keeps_whole = True
