"""Signals wait until a file is written, each of them, and then do what they would."""

import signal
import threading

import pytest

from tests.kit import python, refuses
from ttus_opt.core import interrupts


@pytest.mark.parametrize(
    "kind", [signal.SIGINT, signal.SIGTERM, interrupts.INTERRUPT, interrupts.ALARM]
)
def test_a_signal_comes_when_all_is_written(kind):
    came: list[str] = []
    before = signal.signal(kind, lambda *_: came.append("signal"))
    try:
        with interrupts.signals_deferred():
            signal.raise_signal(kind)
            came.append("written")
        assert came == ["written", "signal"]
        signal.raise_signal(kind)
        assert came == ["written", "signal", "signal"]
    finally:
        signal.signal(kind, before)


def test_an_interrupt_ends_what_comes_after():
    done = False
    with pytest.raises(KeyboardInterrupt), interrupts.signals_deferred():
        signal.raise_signal(signal.SIGINT)
        done = True
    assert done


def test_a_mistake_meanwhile_leaves_the_handlers_as_they_were():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyError), interrupts.signals_deferred():
        raise KeyError("a mistake")
    assert signal.getsignal(signal.SIGTERM) is before


def test_another_thread_may_write_as_well():
    before, within = signal.getsignal(signal.SIGINT), list[object]()

    def write():
        with interrupts.signals_deferred():
            within.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=write)
    thread.start()
    thread.join()
    assert within == [before]


@pytest.mark.parametrize("kind", ["signal.SIGINT", "INTERRUPT"])
def test_what_loads_ends_at_once_and_without_a_traceback(kind):
    program = f"""
import signal
from ttus_opt.core.interrupts import INTERRUPT, ended_at_once
with ended_at_once():
    try:
        signal.raise_signal({kind})
    except BaseException:
        print("seen")
"""
    done = python("-c", program, status=130)
    assert (done.stdout, done.stderr) == ("", f"\n{interrupts.STOPPED}\n")


@pytest.mark.parametrize("kind", [signal.SIGINT, interrupts.INTERRUPT])
def test_once_loaded_an_interrupt_is_an_exception(kind):
    before = signal.getsignal(interrupts.INTERRUPT)
    try:
        with interrupts.ended_at_once():
            pass
        refuses(KeyboardInterrupt, "", signal.raise_signal, kind)
    finally:
        signal.signal(interrupts.INTERRUPT, before)


def test_an_interrupt_that_is_ignored_stays_so():
    before = {s: signal.getsignal(s) for s in (signal.SIGINT, interrupts.INTERRUPT)}
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupts.ended_at_once():
            signal.raise_signal(signal.SIGINT)
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def test_a_handler_that_was_set_meanwhile_stays():
    before = signal.getsignal(signal.SIGINT)
    try:
        with interrupts.ended_at_once():
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
