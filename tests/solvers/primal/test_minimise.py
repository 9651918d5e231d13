"""A dense sum of squares with few rows of any weight, against least squares."""

from dataclasses import dataclass

import numpy as np
import pytest

from ttus_opt.core.arrays import Array
from ttus_opt.solvers.conjugate_gradients import inner_product
from ttus_opt.solvers.dual.solver import Accuracy
from ttus_opt.solvers.primal.least_squares import Goal, minimise

V, FEW = 20, 3


@dataclass
class Dense:
    """F(p) = ‖M p − t‖² + ‖D p − d‖²."""

    M: Array
    t: Array
    D: Array
    d: Array

    @classmethod
    def of(cls, weight):
        rng = np.random.default_rng(0)
        M = rng.normal(size=(V, V)) @ np.diag(np.geomspace(1.0, 30.0, V))
        D = np.sqrt(weight) * rng.normal(size=(FEW, V))
        d = np.sqrt(weight) * rng.normal(size=FEW)
        return cls(M, rng.normal(size=V), D, d)

    def residual(self, at):
        p, y = at[:V], at[V:]
        r = self.M.T @ (self.t - self.M @ p) + self.D.T @ y
        return np.concatenate([r, self.d - self.D @ p - y])

    def image(self, along):
        p, y = along[:V], along[V:]
        r = self.M.T @ (self.M @ p) - self.D.T @ y
        return np.concatenate([r, self.D @ p + y])

    def pairing(self, rest, along):
        return float(self.gradient(rest) @ along[:V])

    def gradient(self, rest):
        return np.asarray(rest[:V] + self.D.T @ rest[V:])

    def value(self, at):
        p = at[:V]
        return float(
            np.sum((self.M @ p - self.t) ** 2) + np.sum((self.D @ p - self.d) ** 2)
        )

    @property
    def minimiser(self):
        M, t = np.vstack([self.M, self.D]), np.concatenate([self.t, self.d])
        return np.asarray(np.linalg.lstsq(M, t)[0])


@dataclass
class WithRows:
    """Respects the few rows exactly; of the rest it has a prior Hessian P."""

    function: Dense
    P: Array

    def __call__(self, rest):
        D = self.function.D
        z, columns = np.linalg.solve(self.P, rest[:V]), np.linalg.solve(self.P, D.T)
        y = np.linalg.solve(np.eye(FEW) + D @ columns, rest[V:] - D @ z)
        return np.concatenate([z + columns @ y, y])


def preconditioner(function, exact):
    H = function.M.T @ function.M
    return WithRows(function, H if exact else np.diag(np.diagonal(H)))


def run(function, exact, max_steps=200):
    start = np.zeros(V + FEW)
    largest = np.linalg.norm(function.gradient(function.residual(start)))
    goal = Goal(1e-20, 0.0, 1e-11 * float(largest), Accuracy(0.0), max_steps)
    return minimise(function, preconditioner(function, exact), start, goal)


@pytest.mark.parametrize("weight", [1e-6, 1.0, 1e8])
def test_equals_least_squares_at_any_weight_of_the_rows(weight):
    function = Dense.of(weight)
    found, expected = run(function, exact=False), function.minimiser
    assert found.reached
    np.testing.assert_allclose(
        found.at[:V], expected, atol=1e-9 * np.abs(expected).max()
    )
    # multipliers are what the rows leave
    left = function.d - function.D @ found.at[:V]
    np.testing.assert_allclose(found.at[V:], left, atol=1e-6 * np.abs(left).max())


def test_the_exact_inverse_needs_one_step():
    found = run(Dense.of(1.0), exact=True)
    assert (found.reached, found.steps) == (True, 1)


def test_nothing_is_done_past_the_deadline():
    function = Dense.of(1.0)
    late = Goal(1e-22, 0.0, 1e-7, Accuracy(0.0, deadline=0.0))
    start = np.r_[np.ones(V), np.zeros(FEW)]
    found = minimise(function, preconditioner(function, False), start, late)
    assert (found.reached, found.steps) == (False, 0)
    np.testing.assert_array_equal(found.at, start)


def test_a_goal_needs_a_small_gap_and_a_small_gradient():
    goal = Goal(1e-3, 1e-6, 0.1, Accuracy(0.0), 1)
    small, large = np.full(4, 0.04), np.full(4, 0.06)
    assert goal.reached(1e-3, 1.0, small)
    assert not goal.reached(1.1e-3, 1.0, small)
    assert not goal.reached(1e-3, 1.0, large)
    assert goal.reached(1e-6, 0.0, small)  # whatever F is
    assert not goal.times(0.5).reached(1e-3, 1.0, small)
    assert inner_product(small, large) == pytest.approx(4 * 0.04 * 0.06)
