"""Time limits of commands: at the end of its time a command stops as at Ctrl-C."""

from __future__ import annotations

import contextlib
import math
import signal
import sys
import threading
from _thread import interrupt_main
from collections.abc import Callable, Iterator
from typing import NoReturn

import typer

from ttus_opt.cli.supervisor import end_within
from ttus_opt.core.errors import InputError, TtusError
from ttus_opt.core.interrupts import INTERRUPT, raise_interrupt


@contextlib.contextmanager
def time_limited(seconds: float | None) -> Iterator[None]:
    """Interrupt what is done within when its time is over.

    Args:
        seconds: The limit [s]; None for none.

    Raises:
        InputError: The limit is not a positive number.
        TtusError: The time is over; what was interrupted may have kept a part.
    """
    if seconds is None:
        yield
        return
    if not 0.0 < seconds < math.inf:
        raise InputError(f"--time-limit must be positive [s], got {seconds:g}")
    over: list[int] = []

    def stop(number: int, _frame: object) -> NoReturn:
        over.append(number)
        raise KeyboardInterrupt

    try:
        with _alarm(seconds, stop):
            yield
    except (KeyboardInterrupt, typer.Exit):
        if not over:
            raise
        raise TtusError(
            f"the time limit of {seconds:g} s is over: nothing further was written: "
            "allow more with --time-limit"
        ) from None


@contextlib.contextmanager
def interrupts_unwrapped() -> Iterator[None]:
    """Raise an interrupt as such where Python has made it another error, or lost it.

    That is a SystemError where compiled code returned with an exception set, and before
    Python 3.12 a RuntimeError of ``__set_name__`` where a class was being made. One in
    a library's callback, as a compiler's, is lost: it strikes again a moment later.

    Raises:
        KeyboardInterrupt: It came at such a moment.
    """
    before, sys.unraisablehook = sys.unraisablehook, _strike_again
    try:
        yield
    except (SystemError, RuntimeError) as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise KeyboardInterrupt from None
        raise
    finally:
        sys.unraisablehook = before


def _strike_again(lost: sys.UnraisableHookArgs) -> None:
    if not issubclass(lost.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    own = signal.getsignal(INTERRUPT) is raise_interrupt
    number = INTERRUPT if own else signal.SIGINT
    threading.Timer(0.05, interrupt_main, [number]).start()


@contextlib.contextmanager
def _alarm(seconds: float, stop: Callable[[int, object], NoReturn]) -> Iterator[None]:
    """Call ``stop`` in time, where the system and the thread can."""
    main = threading.current_thread() is threading.main_thread()
    if not (main and hasattr(signal, "setitimer")):
        yield
        return
    before = signal.signal(signal.SIGALRM, stop)
    try:
        signal.setitimer(signal.ITIMER_REAL, seconds)
        end_within(seconds)
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        end_within(0.0)
        signal.signal(signal.SIGALRM, before)
