"""Laws of every penalty on the shelf: a new class there is tested by existing."""

import inspect

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from ttus_opt.problem.terms import penalties

RNG = np.random.default_rng(0)

#: What a penalty needs to be made
OPTIONS: dict[str, dict[str, float]] = {
    "Huber": {"threshold": 0.7},
    "Groups": {"size": 3},
}


def members():
    return [
        kind(**OPTIONS.get(kind.__name__, {}))
        for kind in vars(penalties).values()
        if inspect.isclass(kind)
        and issubclass(kind, penalties.Penalty)
        and not inspect.isabstract(kind)
    ]


each_penalty = pytest.mark.parametrize("phi", members(), ids=lambda p: type(p).__name__)


def test_the_shelf_is_found():
    names = {type(phi).__name__ for phi in members()}
    assert {"Squares", "Huber", "Absolute", "Groups", "Linear"} <= names


@each_penalty
def test_the_value_is_cvxpys(phi):
    """Two statements of the same penalty, for our checks and for cone solvers."""
    for scale in (0.1, 1.0, 10.0):
        r = scale * RNG.normal(size=12)
        said = phi.in_cvxpy(cp.Constant(r), cp)
        assert said.is_convex()
        assert phi.value(r) == pytest.approx(float(said.value))
    assert phi.value(np.zeros(12)) == 0.0


@each_penalty
def test_the_subgradient_lies_below_the_penalty(phi):
    for _ in range(10):
        r, other = RNG.normal(size=(2, 12))
        below = phi.value(r) + float(phi.subgradient(r) @ (other - r))
        assert below <= phi.value(other) + 1e-12
    at_zero = phi.subgradient(np.zeros(12))
    assert (np.abs(at_zero).max() == 0.0) or not phi.smooth


@each_penalty
def test_a_smooth_penaltys_gradient_vanishes_with_the_residual(phi):
    steep = np.abs(phi.subgradient(np.full(12, 1e-9))).max()
    assert (steep < 1e-8) == phi.smooth


@each_penalty
def test_multipliers_are_projected(phi):
    """Nearest, and left alone where they are subgradients already."""
    for _ in range(10):
        g, r = 4.0 * RNG.normal(size=(2, 12))
        nearest = phi.admissible(g)
        np.testing.assert_allclose(phi.admissible(nearest), nearest, rtol=1e-14)
        own = phi.subgradient(r)
        np.testing.assert_allclose(phi.admissible(own), own, rtol=1e-12)
        # the obtuse angle of a projection onto a convex set
        assert float((g - nearest) @ (own - nearest)) <= 1e-12


@each_penalty
def test_fenchels_inequality(phi):
    for _ in range(10):
        r = RNG.normal(size=12)
        own, other = phi.subgradient(r), phi.admissible(3.0 * RNG.normal(size=12))
        assert phi.value(r) + phi.conjugate(own) == pytest.approx(float(own @ r))
        assert phi.value(r) + phi.conjugate(other) >= float(other @ r) - 1e-12


@each_penalty
def test_a_split_has_the_penalty_as_its_least_value(phi):
    split = phi.split
    if split is None:
        return
    for r in (-2.0, -0.3, 0.0, 0.4, 3.0):
        price = np.full(2, split.slope)
        if split.squares_rest:
            least = minimize(
                lambda v, r=r, c=price: (r - v[0] + v[1]) ** 2 + float(c @ v),
                np.ones(2),
                bounds=[(0.0, None)] * 2,
                tol=1e-12,
            ).fun
        else:
            least = linprog(price, A_eq=[[1.0, -1.0]], b_eq=[r]).fun
        assert least == pytest.approx(phi.value(np.array([r])), abs=1e-6)


@each_penalty
def test_the_gauge_says_how_much_too_long_a_multiplier_is(phi):
    for _ in range(10):
        g = 4.0 * RNG.normal(size=12)
        t = phi.gauge(g)
        if not np.isfinite(t):
            assert phi.gauge(np.zeros(12)) == t  # not stated
            return
        at, beyond = g / t, g / (0.999 * t)
        np.testing.assert_allclose(phi.admissible(at), at, rtol=1e-12)
        assert np.abs(phi.admissible(beyond) - beyond).max() > 0.0


@each_penalty
def test_no_residual_of_a_value_is_longer(phi):
    """Of one that is all in one place as of one that is spread."""
    alone = np.eye(1, 12).reshape(-1)
    for r in (*RNG.normal(size=(10, 12)), alone, 1e3 * alone, 1e-3 * alone):
        assert np.linalg.norm(r) <= phi.farthest(phi.value(r)) * (1.0 + 1e-12)
