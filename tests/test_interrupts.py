"""Signals wait until a file is written, each of them, and then do what they would."""

from __future__ import annotations

import signal
import threading

import pytest

from ttus_opt.interrupts import INTERRUPT, signals_deferred


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, INTERRUPT])
def test_a_signal_comes_when_all_is_written(kind: signal.Signals) -> None:
    came: list[str] = []
    before = signal.signal(kind, lambda *_: came.append("signal"))
    try:
        with signals_deferred():
            signal.raise_signal(kind)
            came.append("written")
        assert came == ["written", "signal"]
        signal.raise_signal(kind)
        assert came == ["written", "signal", "signal"]
    finally:
        signal.signal(kind, before)


def test_an_interrupt_ends_what_comes_after() -> None:
    done = False
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), signals_deferred():
            signal.raise_signal(signal.SIGINT)
            done = True
    finally:
        signal.signal(signal.SIGINT, before)
    assert done


def test_a_mistake_meanwhile_leaves_the_handlers_as_they_were() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyError), signals_deferred():
        raise KeyError("a mistake")
    assert signal.getsignal(signal.SIGTERM) is before


def test_another_thread_may_write_as_well() -> None:
    before, within = signal.getsignal(signal.SIGINT), list[object]()

    def write() -> None:
        with signals_deferred():
            within.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=write)
    thread.start()
    thread.join()
    assert within == [before]
