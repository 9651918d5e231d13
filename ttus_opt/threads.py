"""The same work on many things, side by side on the processor's cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

Result = TypeVar("Result")


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
    with ThreadPoolExecutor(usable_cores()) as pool:
        return list(pool.map(work, *things))
