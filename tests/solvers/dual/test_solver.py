"""One dual solve: refinement, and unknowns beside the field that change sides."""

import time

import numpy as np
import pytest

from tests.solvers.dual.user_limits import contested, eq10
from ttus_opt.core.arrays import Array
from ttus_opt.solvers.dual import options
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.linear_parameters import Complement, LinearParameters
from ttus_opt.solvers.dual.solver import Accuracy, DualSolver
from ttus_opt.solvers.dual.system import DualSystem


def data_of(weight, seed=0):
    return DualData.of(eq10(contested(seed), weight).compile())


class Inexact(DualSystem):
    """Products with the Schur complement that are off by a thousandth."""

    def apply(self, y, rtol=1e-12):
        return y + 1.001 * (super().apply(y, rtol) - y)


def test_refinement_makes_up_for_inexact_products(monkeypatch):
    """What such products leave is solved for again, from the field's own residual."""
    data = data_of(1.0)
    exact = DualSolver(data.system).solve(data.b, data.t, Accuracy(1e-12)).p
    s = data.system
    system = Inexact(s.laplace, s.compliance, s.rows, s.root_weights)

    def error(refinements):
        monkeypatch.setattr(options, "REFINEMENTS", refinements)
        solver = DualSolver(system)
        found = solver.solve(data.b, data.t, Accuracy(1e-9)).p
        return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))

    assert error(1) > 1e-6
    assert error(8) <= 1e-8


@pytest.fixture
def taken(monkeypatch):
    """Steps of every run of conjugate gradients."""
    counts = []
    plain = Complement.solve

    def counted(*given):
        found = plain(*given)
        counts.append(found.steps)
        return found

    monkeypatch.setattr(Complement, "solve", counted)
    return counts


def test_steps_are_those_of_all_refinements(taken):
    data = data_of(1.0)
    s = data.system
    system = Inexact(s.laplace, s.compliance, s.rows, s.root_weights)
    answer = DualSolver(system).solve(data.b, data.t, Accuracy(1e-9))
    assert len(taken) > 1
    assert answer.steps == sum(taken) > 0


def test_what_is_exact_enough_is_not_refined(taken):
    data = data_of(1.0)
    answer = DualSolver(data.system).solve(data.b, data.t, Accuracy(1e-6))
    assert taken == [answer.steps]


def test_out_of_time_there_is_one_refinement(taken):
    data = data_of(1.0)
    late = Accuracy(1e-9, deadline=0.0)
    answer = DualSolver(data.system).solve(data.b, data.t, late)
    assert answer.late and len(taken) == 1


def dense(data, beside):
    """The best c between its bounds, by projected coordinate descent on EᵀS⁻¹E."""
    system = data.system
    S = np.array([system.apply(e) for e in np.eye(len(data.t))])
    E = beside.columns
    H, g = (
        E.T @ np.linalg.solve(S, E),
        E.T @ np.linalg.solve(S, data.t - system.measure(system.laplace.solve(data.b))),
    )
    c = np.zeros(E.shape[1])
    for _ in range(2000):
        for k in range(len(c)):
            step = (g[k] - H[k] @ c) / H[k, k]
            c[k] = np.clip(c[k] + step, beside.lower[k], beside.upper[k])
    return c


@pytest.mark.parametrize("seed", range(2))
def test_bounds_of_many_unknowns_beside_the_field(seed):
    """Correlated columns and narrow bounds: several sets are tried."""
    data = data_of(1.0, seed)
    rng = np.random.default_rng(seed)
    E = rng.normal(size=(len(data.t), 6)) @ rng.normal(size=(6, 6))
    reach = rng.uniform(0.05, 1.0, 6)
    beside = LinearParameters(E, -reach, reach)
    solver = DualSolver(data.system, beside)
    expected = dense(data, beside)
    assert 0 < np.sum(np.abs(expected) == reach) < 6
    for near in (None, reach, np.zeros(6)):
        answer = solver.solve(data.b, data.t, Accuracy(1e-10), near=near)
        np.testing.assert_allclose(answer.c, expected, atol=1e-7)


def test_bounds_that_never_settle_end(monkeypatch):
    """Where solves are too rough for Murty's rule, sets of bounds return."""
    data = data_of(1.0)
    columns = np.random.default_rng(0).normal(size=(len(data.t), 3))
    beside = LinearParameters(columns, np.full(3, -1.0), np.full(3, 1.0))
    solved = []

    def never_right(self, c, y, free):
        solved.append(free)
        return np.ones(3, dtype=bool)

    monkeypatch.setattr(LinearParameters, "violating", never_right)
    solver = DualSolver(data.system, beside)
    c = solver.solve(data.b, data.t, Accuracy(1e-3)).c
    assert (np.abs(c) <= 1.0).all()
    assert 3 < len(solved) <= 2 * 2**3


@pytest.mark.parametrize("weight", [0.5, 2.0])
def test_other_weights_keep_the_subspace_and_other_columns_lose_it(weight):
    """Whether all weights rise or all fall."""
    data = data_of(1.0)
    rng = np.random.default_rng(1)
    E = rng.normal(size=(len(data.t), 2))
    free = np.full(2, np.inf)
    solver = DualSolver(data.system, LinearParameters(E, -free, free))
    solver.solve(data.b, data.t, Accuracy(1e-9))
    other = data_of(weight)
    ratio = other.system.root_weights / data.system.root_weights
    for columns in (ratio[:, None] * E, E[::-1]):
        beside = LinearParameters(columns, -free, free)
        solver.adopt(other.system, beside)
        again = solver.solve(other.b, other.t, Accuracy(1e-9))
        fresh = DualSolver(other.system, beside).solve(other.b, other.t, Accuracy(1e-9))
        np.testing.assert_allclose(again.c, fresh.c, rtol=1e-6)
        np.testing.assert_allclose(again.p, fresh.p, atol=1e-7 * np.abs(fresh.p).max())
        assert again.steps <= fresh.steps


def test_the_prior_s_field_is_kept_while_it_serves(monkeypatch):
    """Solved for anew with another b, and where more is asked of it."""
    data = data_of(1.0)
    solver, laplace = DualSolver(data.system), type(data.system.laplace)
    plain, solved = laplace.solve, list[Array]()

    def counted(self, b, *given, **more):
        solved.append(b)
        return plain(self, b, *given, **more)

    monkeypatch.setattr(laplace, "solve", counted)
    runs = ((1, 1e-6), (2, 1e-6), (2, 1e-9), (2, 1e-9), (2, 1e-6), (1, 1e-9))
    new = []
    for factor, rtol in runs:
        b = factor * data.b
        before = len(solved)
        found = solver.solve(b, data.t, Accuracy(1e-9, rtol)).p
        new.append(any(np.array_equal(b, other) for other in solved[before:]))
        fresh = DualSolver(data.system).solve(b, data.t, Accuracy(1e-9, rtol)).p
        assert np.linalg.norm(found - fresh) <= 1e3 * rtol * np.linalg.norm(fresh)
    assert new == [True, True, True, False, False, True]


def test_a_deadline_passes():
    now = time.perf_counter()
    assert not Accuracy(1e-8).late
    assert not Accuracy(1e-8, deadline=now + 60.0).late
    assert Accuracy(1e-8, deadline=now - 1.0).late
