"""A tolerance and a time limit in a package's own words."""

import math
import signal
import threading

from tests.kit import refuses
from tests.solvers.problems import program, term
from ttus_opt.solvers.packages.package import PackageSolver, interruptible
from ttus_opt.solvers.sizes import interior_point_seconds

PLAIN = PackageSolver(
    "a", "", "a", ("rel", "gap"), ("abs",), "seconds", {"rho": 3}, 1e-10
)


def test_every_option_has_its_number():
    assert PLAIN.options(1e-8, 5) == {
        "rel": 1e-8, "gap": 1e-8, "abs": 1e-10, "rho": 3, "seconds": 5.0,
    }  # fmt: skip
    assert "seconds" not in PLAIN.options(1e-8, None)
    assert PLAIN.options(1e-14, None)["rel"] == 1e-10


def test_options_may_stand_within_another():
    within = PackageSolver("a", "", "a", ("rel",), within="params")
    assert within.options(1e-6, 5.0) == {"params": {"rel": 1e-6}}


def test_a_package_without_an_estimate_is_never_the_cheapest():
    small = program([term([[1.0]], [1.0])])
    cheap = PackageSolver("b", "", "b", ("rel",), effort=2.0)
    assert cheap.cost(small) == 2.0 * interior_point_seconds(small) and cheap.estimates
    assert PLAIN.cost(small) == math.inf and not PLAIN.estimates


def test_interruptible_work_returns_and_raises():
    assert interruptible(lambda: threading.current_thread().name) == "solver"
    refuses(ZeroDivisionError, "", interruptible, lambda: 1 // 0)


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

    try:
        refuses(KeyboardInterrupt, "", interruptible, work)
        assert begun.is_set() and not done.is_set()
    finally:
        over.set()
    assert done.wait(10.0)
