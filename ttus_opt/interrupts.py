"""Interrupts: the signal that stops a command, and its delay during a file write."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator

#: Signal by which `ttus_opt.cli.supervisor` asks the command it watches to stop
INTERRUPT = getattr(signal, "SIGUSR1", signal.SIGINT)


@contextlib.contextmanager
def signals_deferred() -> Iterator[None]:
    """Delay interrupts and termination until a file is written.

    An exception inside the netCDF library would leave its lock taken, and the next
    writer would wait forever. Only the main thread receives signals; in other threads
    this does nothing.
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
        for number in received:  # the first that is not ignored ends the loop
            signal.raise_signal(number)
