"""A tolerance and a time limit in a package's own words."""

import math

from tests.solvers.problems import program, term
from ttus_opt.solvers.packages.package import Package, PackageSolver

PLAIN = Package("a", "", "a", ("rel", "gap"), ("abs",), "seconds", {"rho": 3}, 1e-10)


def test_every_option_has_its_number():
    assert PLAIN.options(1e-8, 5) == {
        "rel": 1e-8, "gap": 1e-8, "abs": 1e-10, "rho": 3, "seconds": 5.0,
    }  # fmt: skip
    assert "seconds" not in PLAIN.options(1e-8, None)
    assert PLAIN.options(1e-14, None)["rel"] == 1e-10


def test_options_may_stand_within_another():
    within = Package("a", "", "a", ("rel",), within="params")
    assert within.options(1e-6, 5.0) == {"params": {"rel": 1e-6}}


def test_a_package_without_an_estimate_is_never_the_cheapest():
    small = program([term([[1.0]], [1.0])])
    cheap = Package("b", "", "b", ("rel",), cost=lambda program: 2.0)
    assert PackageSolver(cheap).cost(small) == 2.0
    assert PackageSolver(PLAIN).cost(small) == math.inf
