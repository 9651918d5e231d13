"""Interrupts: how a command is told to stop, and held back while a file is written."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator

#: How the process that watches a command tells it to stop (`ttus_opt.cli.supervisor`)
INTERRUPT = getattr(signal, "SIGUSR1", signal.SIGINT)


@contextlib.contextmanager
def signals_deferred() -> Iterator[None]:
    """Hold interrupts and termination back until a file is written.

    An exception in the middle of the netCDF library leaves its lock taken and the next
    writer waiting for ever. Only the main thread receives signals; elsewhere this does
    nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    deferred = dict.fromkeys((signal.SIGINT, signal.SIGTERM, INTERRUPT))
    before = [signal.signal(s, lambda n, _: received.append(n)) for s in deferred]
    try:
        yield
    finally:
        for kind, handler in zip(deferred, before, strict=True):
            signal.signal(kind, handler or signal.SIG_DFL)
        for number in received:  # the first that is not ignored ends this
            signal.raise_signal(number)
