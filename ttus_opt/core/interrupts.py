"""Interrupts: the signal that stops a command, and its delay where none may strike."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType

#: Signal by which `ttus_opt.cli.supervisor` asks the command it watches to stop
INTERRUPT = getattr(signal, "SIGUSR1", signal.SIGINT)

#: Signal at the end of a command's time
ALARM = getattr(signal, "SIGALRM", signal.SIGINT)

#: What a command that was stopped says, and its exit status
STOPPED, INTERRUPTED = "error: interrupted: nothing further was written", 130


@contextlib.contextmanager
def ended_at_once() -> Iterator[None]:
    """End the process at once at an interrupt: while it loads there is no work to save.

    An exception would strike anywhere in an import, and show the user where. Signals
    that are ignored stay so.
    """
    after = {INTERRUPT: raise_interrupt, signal.SIGINT: signal.getsignal(signal.SIGINT)}
    for kind in after:
        if signal.getsignal(kind) != signal.SIG_IGN:
            signal.signal(kind, _end)
    try:
        yield
    finally:
        for kind, handler in after.items():
            if signal.getsignal(kind) is _end:  # no other has been set meanwhile
                signal.signal(kind, handler)


def raise_interrupt(number: int, frame: FrameType | None) -> None:
    """Handler of `INTERRUPT`, as Python's own of Ctrl-C."""
    raise KeyboardInterrupt


def _end(number: int, frame: FrameType | None) -> None:
    os.write(2, f"\n{STOPPED}\n".encode())
    os._exit(INTERRUPTED)


@contextlib.contextmanager
def signals_deferred() -> Iterator[None]:
    """Delay signals that end until a file is written or a process started.

    An exception inside the netCDF library would leave its lock taken, and the next
    writer would wait forever; a process half started shows its own traceback.
    Only the main thread receives signals; in other threads this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    kinds = dict.fromkeys((signal.SIGINT, signal.SIGTERM, INTERRUPT, ALARM))
    # one that is ignored stays so, for processes started meanwhile as well
    before = {s: h for s in kinds if (h := signal.getsignal(s)) != signal.SIG_IGN}
    for kind in before:
        signal.signal(kind, lambda n, _: received.append(n))
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler or signal.SIG_DFL)
        for number in received:  # the first whose handler raises ends the loop
            signal.raise_signal(number)
