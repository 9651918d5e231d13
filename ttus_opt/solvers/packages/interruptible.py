"""Long calls into other packages that Ctrl-C can interrupt.

Python handles an interrupt in the main thread, between two of its own instructions, and
therefore only after a call into a library has returned. `ttus-opt` runs its commands in
a process that can be terminated; in notebooks and scripts this module helps.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

#: Interval at which the main thread checks for an interrupt [s]
PAUSE = 0.1


def interruptible(work: Callable[[], T]) -> T:
    """Run a function in a thread while the main thread waits for it.

    An interrupt takes effect at once where the library releases Python's lock, as
    Clarabel, HiGHS and SCS do. The work itself cannot be stopped: it finishes in the
    background, and its result is dropped.

    Args:
        work: Called directly where this is not the main thread.

    Returns:
        Its result; its exceptions are raised here.
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
