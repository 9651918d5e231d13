"""Long calls of other packages that leave Python free to hear an interrupt.

Python handles an interrupt between two of its own instructions, in the main thread: a
call into a library keeps it waiting for as long as it computes. `ttus-opt` runs its
commands in a process that can be ended; notebooks and scripts have this.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

#: How long the main thread waits before it looks for an interrupt [s]
PAUSE = 0.1


def interruptible(work: Callable[[], T]) -> T:
    """Do some work in a thread while the main thread waits for it.

    An interrupt is heard at once where the library gives Python's lock away while it
    computes, as Clarabel, HiGHS and SCS do. The work cannot be ended: it goes on in the
    background until it is done, and what it returns is dropped.

    Args:
        work: Takes nothing; done directly where this is not the main thread.

    Returns:
        What it returns; what it raises is raised.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    found: list[T] = []
    raised: list[BaseException] = []

    def run() -> None:
        try:
            found.append(work())
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run, name="solver", daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(PAUSE)
    if raised:
        raise raised[0]
    return found[0]
