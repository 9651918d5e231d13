"""A command runs in a child process, so that Ctrl-C ends it whatever it is doing.

Python handles a signal between two of its own instructions: a factorisation in a
library keeps it waiting for minutes, and some solvers catch the interrupt themselves.
The process the user started only waits. It passes an interrupt on, gives
the child a moment to clean up, and then ends it; likewise when its time is over.
"""

from __future__ import annotations

import contextlib
import math
import mmap
import os
import signal
import struct
import sys
import time
from types import FrameType

from ttus_opt.core.interrupts import INTERRUPT, INTERRUPTED, STOPPED, raise_interrupt

#: Commands that are over at once, or watch children of their own
ALONE = ("benchmark", "formulations", "solvers", "warm-up")

#: What a child that was asked to stop is given to clean up [s]
GRACE = 1.0

#: A path writes the points it has, when its solver listens; a recording or a live
#: session what came; a viewer tells its pages [s]
LONGER = {"live": 10.0, "path": 10.0, "record": 10.0, "view": 10.0}

BAD_INPUT, TERMINATED = 2, 143

#: How often the clock is looked at [s]
TICK = 1.0

#: When a child's time is over, by `time.monotonic` [s], 0 for never; it writes, its
#: parent reads
_END = mmap.mmap(-1, 8)


def end_within(seconds: float) -> None:
    """Have the waiting process end this one when its time is over, if it does not.

    Args:
        seconds: Its time from now, 0 for any [s].
    """
    end = time.monotonic() + seconds if seconds else 0.0
    struct.pack_into("d", _END, 0, end)


def run_supervised(command: str) -> None:
    """Go on in a child process, where the system can fork.

    Returns in the child; the process itself waits and ends as the child does.

    Args:
        command: The first word of the command line.
    """
    computes = command[:1] not in ("", "-") and command not in ALONE
    if not (computes and hasattr(os, "fork")):
        return
    # none may strike before both have their handlers
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    child = os.fork()
    if child:
        os._exit(_watch(child, LONGER.get(command, GRACE), before))
    _end_with_parent()
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        # a terminal interrupts parent and child alike: only the parent's word counts,
        # or the second interrupt would strike while the first is cleaned up after;
        # the child's own children, which ignore it too, are ended by the child
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if signal.getsignal(INTERRUPT) == signal.SIG_DFL:
            signal.signal(INTERRUPT, raise_interrupt)
    signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _watch(child: int, grace: float, mask: set[signal.Signals | int]) -> int:
    """Wait for a child and pass signals on; the exit status it leaves.

    Args:
        child: Its process number.
        grace: What it is given to clean up; a second interrupt ends it at once [s].
        mask: Signals to be blocked once those are handled that were blocked.
    """
    stopped: list[int] = []
    late: list[float] = []
    over = math.inf  # when what it is given to clean up is over

    def send(number: int) -> None:
        with contextlib.suppress(ProcessLookupError):  # it has just ended
            os.kill(child, number)

    def look(*_: object) -> None:
        (end,) = struct.unpack_from("d", _END)
        now = time.monotonic()
        # a tick may come with the interrupt itself, and is then handled after it
        if now >= over or (not stopped and 0.0 < end < now - grace):
            late.append(end)
            send(signal.SIGKILL)

    def stop(number: int, _frame: FrameType | None) -> None:
        nonlocal over
        if stopped:
            send(signal.SIGKILL)
            return
        stopped.append(INTERRUPTED if number == signal.SIGINT else TERMINATED)
        send(INTERRUPT if number == signal.SIGINT else signal.SIGTERM)
        over = time.monotonic() + grace
        signal.setitimer(signal.ITIMER_REAL, grace, TICK)

    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGALRM, look)
    signal.setitimer(signal.ITIMER_REAL, TICK, TICK)
    signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if late and not stopped:
        _tell("error: the time limit is over: nothing further was written")
        return BAD_INPUT
    if not stopped:
        return code if code >= 0 else _like_the_child(-code)
    if code == -signal.SIGKILL and stopped[0] == INTERRUPTED:
        _tell(STOPPED)
    return stopped[0] if code else 0


def _tell(line: str) -> None:
    sys.stderr.write(f"\n{line}\n")
    sys.stderr.flush()


def _like_the_child(number: int) -> int:
    """End by the signal that ended the child, so that a shell tells the same."""
    with contextlib.suppress(OSError, ValueError):  # SIGKILL takes no handler
        signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)
    return 128 + number


def _end_with_parent() -> None:
    """Do not outlive the parent, where the system can promise that."""
    if sys.platform != "linux":
        return
    import ctypes

    set_parent_death_signal = 1
    ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)
