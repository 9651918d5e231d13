"""Work in a thread, from which an interrupt calls away."""

import signal
import threading

import pytest

from ttus_opt.solvers.packages.interruptible import interruptible


def test_what_it_returns_and_raises():
    assert interruptible(lambda: threading.current_thread().name) == "solver"
    with pytest.raises(ZeroDivisionError):
        interruptible(lambda: 1 // 0)


def test_elsewhere_than_in_the_main_thread_it_is_done_directly():
    names = []

    def work():
        names.append(interruptible(lambda: threading.current_thread().name))

    thread = threading.Thread(target=work, name="mine")
    thread.start()
    thread.join()
    assert names == ["mine"]


def test_an_interrupt_is_heard_while_it_goes_on():
    begun, over, done = (threading.Event() for _ in range(3))

    def work():
        begun.set()
        signal.raise_signal(signal.SIGINT)  # Python hands it to the main thread
        over.wait()  # as a library that computes
        done.set()

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            interruptible(work)
        assert begun.is_set() and not done.is_set()
    finally:
        signal.signal(signal.SIGINT, before)
        over.set()
    assert done.wait(10.0)
