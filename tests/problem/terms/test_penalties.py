"""Penalties by hand, by searches and by dense matrices: values, slopes, resolvents."""

import math

import numpy as np
import pytest

from tests.kit import InputError, refuses
from ttus_opt.problem.terms.penalties import (
    Absolute,
    Groups,
    Huber,
    Linear,
    Penalty,
    Slope,
    Squares,
)

PAIRS = Groups(2)
V = np.random.default_rng(0).normal(0.0, 2.0, 30)
each_penalty = pytest.mark.parametrize(
    "penalty", [Squares(), Absolute(), Huber(0.4), Groups(3), Linear()], ids=repr
)


class Fourth(Penalty):
    """Σ r⁴/4, with what has to be stated and no more."""

    formula = "Σ r⁴/4"

    def value(self, r):
        return float((r**4).sum()) / 4.0

    def subgradient(self, r):
        return np.asarray(r**3)

    def admissible(self, g):
        return g

    def conjugate(self, g):
        return 0.75 * float((np.abs(g) ** (4.0 / 3.0)).sum())

    def in_cvxpy(self, r, cp):
        return cp.sum(cp.power(r, 4)) / 4.0


def test_what_is_not_stated_claims_nothing():
    phi = Fourth()
    assert phi.rows_per_group == 1 and phi.split is None
    assert not phi.quadratic and not phi.smooth
    assert phi.gauge(np.ones(3)) == phi.farthest(1.0) == math.inf
    words = "Fourth does not implement resolvent"
    refuses(InputError, words, phi.resolvent, np.ones(3), 1.0)


@pytest.mark.parametrize("size", [1, 2, 3])
def test_a_slope_is_the_matrix_it_stands_for(size):
    """Factor times I − n nᵀ, group by group."""
    rng = np.random.default_rng(0)
    factor = np.repeat(rng.uniform(0.1, 2.0, 6 // size), size)
    along = rng.normal(size=(6 // size, size))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    slope = Slope(factor, along.reshape(-1), size)
    dense = np.zeros((6, 6))
    for k, n in enumerate(along):
        at = slice(k * size, (k + 1) * size)
        dense[at, at] = factor[k * size] * (np.eye(size) - np.outer(n, n))
    found = np.column_stack([slope.times(unit) for unit in np.eye(6)])
    np.testing.assert_allclose(found, dense, atol=1e-14)
    plain = np.column_stack([Slope(factor).times(unit) for unit in np.eye(6)])
    np.testing.assert_array_equal(plain, np.diag(factor))


@pytest.mark.parametrize("step", [1e-3, 1.0, 1e3])
@each_penalty
def test_a_resolvent_splits_v_into_a_residual_and_its_subgradient(penalty, step):
    """v = g + step z with g a subgradient at z, by Fenchel's equality."""
    g, _ = penalty.resolvent(V, step)
    z = (V - g) / step
    np.testing.assert_allclose(penalty.admissible(g), g, rtol=0, atol=1e-12)
    missing = penalty.value(z) + penalty.conjugate(g) - g @ z
    assert abs(missing) <= 1e-9 * (1.0 + abs(penalty.value(z)))


@each_penalty
def test_a_slope_is_the_resolvents_derivative(penalty):
    along = np.random.default_rng(1).normal(size=len(V))
    ends = [penalty.resolvent(V + side * 1e-6 * along, 0.7)[0] for side in (1.0, -1.0)]
    _, slope = penalty.resolvent(V, 0.7)
    expected = (ends[0] - ends[1]) / 2e-6
    np.testing.assert_allclose(slope.times(along), expected, rtol=0, atol=1e-7)


def test_absolute_values_and_signs():
    phi, r = Absolute(), np.array([0.5, -2.0, 0.0])
    assert phi.value(r) == 2.5
    np.testing.assert_array_equal(phi.subgradient(r), [1.0, -1.0, 0.0])
    np.testing.assert_array_equal(phi.admissible(3.0 * r), [1.0, -1.0, 0.0])
    assert phi.gauge(r) == 2.0 and phi.farthest(2.5) == 2.5
    # what is left of the resolvent is a soft threshold
    v, step = np.array([0.7, -3.0, 1.4]), 2.0
    g, slope = phi.resolvent(v, step)
    z = np.sign(v / step) * np.maximum(np.abs(v / step) - 1.0 / step, 0.0)
    np.testing.assert_allclose((v - g) / step, z)
    np.testing.assert_array_equal(slope.factor, [1.0, 0.0, 0.0])


def test_the_value_is_the_sum_of_lengths():
    assert PAIRS.value(np.array([3.0, 4.0, 0.0, -2.0])) == pytest.approx(7.0)
    found = PAIRS.subgradient(np.array([3.0, 4.0, 0.0, 0.0]))
    np.testing.assert_allclose(found, [0.6, 0.8, 0.0, 0.0])
    found = PAIRS.subgradient(np.array([3e-9, -4e-9, 0.0, 0.2]))
    np.testing.assert_allclose(found, [0.6, -0.8, 0.0, 1.0])
    assert PAIRS.gauge(np.array([3.0, 4.0, 0.0, 2.0])) == pytest.approx(5.0)
    shortened = PAIRS.admissible(np.array([3.0, 4.0, 0.3, 0.4]))
    np.testing.assert_allclose(shortened, [0.6, 0.8, 0.3, 0.4])


def test_a_sum_has_one_gradient_whatever_the_residual():
    phi, r = Linear(), np.array([0.5, -2.0])
    assert phi.value(r) == -1.5
    for g in (phi.subgradient(r), phi.admissible(r), phi.resolvent(r, 0.3)[0]):
        np.testing.assert_array_equal(g, [1.0, 1.0])
    assert not phi.resolvent(r, 0.3)[1].factor.any()
    # sup g r − r is bounded at g = 1 alone
    assert phi.conjugate(np.ones(2)) == 0.0


def test_squares_by_hand():
    phi, R = Squares(), np.array([0.5, -2.0, 1.0])
    assert phi.value(R) == 5.25
    np.testing.assert_array_equal(phi.subgradient(R), [1.0, -4.0, 2.0])
    # sup g r − r² lies at r = g/2
    assert phi.conjugate(2.0 * R) == phi.value(R)
    g, _ = phi.resolvent(R, 2.0)
    np.testing.assert_allclose(g, phi.subgradient((R - g) / 2.0))
    # without a kink Huber's is the same
    wide = Huber(1e3)
    assert wide.value(R) == phi.value(R)
    for step in (0.1, 10.0):
        g, slope = phi.resolvent(R, step)
        again, other = wide.resolvent(R, step)
        np.testing.assert_array_equal(g, again)
        np.testing.assert_array_equal(slope.factor, other.factor)


def test_outside_the_ball_only_turning_counts_and_inside_multipliers_follow_v():
    v, across = np.array([3.0, 4.0]), np.array([-4.0, 3.0])
    g, slope = PAIRS.resolvent(v, 1.0)
    np.testing.assert_allclose(slope.times(v), 0.0, atol=1e-15)
    turned = PAIRS.resolvent(v + 1e-6 * across, 1.0)[0] - g
    np.testing.assert_allclose(slope.times(across), turned / 1e-6, rtol=1e-5)
    v = np.array([0.3, -0.4])
    g, slope = PAIRS.resolvent(v, 1.0)
    np.testing.assert_array_equal(g, v)
    np.testing.assert_array_equal(slope.times(v), v)
