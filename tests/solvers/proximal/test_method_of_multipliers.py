"""The method of multipliers with Newton steps by dense algebra, against enumeration."""

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp

from tests.solvers.problems import program, rows, term
from ttus_opt.problem.terms.penalties import Absolute
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.proximal import method_of_multipliers
from ttus_opt.solvers.proximal.method_of_multipliers import (
    MethodOfMultipliers,
    line_search,
)
from ttus_opt.solvers.proximal.problem import PenalisedProblem

WEIGHT = 3.0


class Dense:
    """Newton steps by dense algebra, of the length a test wants.

    Nothing may be asked of given values, and nothing is promised there.
    """

    rtol = 1e-6

    def __init__(self, problem, size=1.0):
        self._free, self._blocks, self._size = ~problem.fixed, problem.blocks, size
        self.asked: list[float] = []

    def step(self, gradient, multipliers, slopes, rtol, deadline):
        self.asked.append(rtol)
        n, free = len(gradient), self._free
        assert not gradient[~free].any()
        H = np.zeros((n, n))
        for block, slope in zip(self._blocks, slopes, strict=True):
            M = block.matrix.toarray()
            H += M.T @ np.column_stack([slope.times(e) for e in np.eye(len(M))]) @ M
        d = np.ones(n)
        d[free] = np.linalg.lstsq(H[np.ix_(free, free)], -gradient[free])[0]
        return self._size * d, 3

    def taken(self, length):
        """Nothing follows it."""


def method_of(what, *, anchor=None, size=1.0, request=None):
    """The method, with an anchor ½ ‖x − x̄‖² at a point or without."""
    problem = PenalisedProblem.of(what)
    for block in problem.bent:
        block.sigma = 1.0
    if anchor is not None:
        n = len(problem.fixed)
        problem = problem.anchored(sp.csr_array(sp.eye_array(n, format="csr")))
        problem.anchor.weigh(0.5)
        problem.anchor.follow(anchor, None, 1.0)
    system = Dense(problem, size)
    asked = request or Request(1e-9)
    return MethodOfMultipliers(problem, system, asked), system


def lasso(seed, shape=(9, 5)):
    """‖A x − b‖² + w Σ |x|."""
    rng = np.random.default_rng(seed)
    n = shape[1]
    return program(
        [
            term(rng.normal(size=shape), rng.normal(size=shape[0])),
            term(np.eye(n), np.zeros(n), WEIGHT, Absolute(), name="bent"),
        ]
    )


def enumerated(what):
    """The minimiser of a lasso: of all sign patterns the one that is consistent."""
    A, b = what.terms[0].matrix.toarray(), what.terms[0].target
    best, least = np.zeros(A.shape[1]), what.objective(np.zeros(A.shape[1]))
    for signs in itertools.product([-1.0, 0.0, 1.0], repeat=A.shape[1]):
        s = np.array(signs)
        on = s != 0.0
        x = np.zeros(len(s))
        normal = A[:, on].T @ A[:, on]
        x[on] = np.linalg.solve(normal, A[:, on].T @ b - WEIGHT / 2.0 * s[on])
        if what.objective(x) < least:
            best, least = x, what.objective(x)
    return best


def verified(what, found, tolerance=1e-9):
    assert found.claim is Claim.DONE and found.x is not None
    assert kkt_residuals(what, found.x, found.duals).worst_relative <= tolerance
    return found.x


@pytest.mark.parametrize("seed", range(2))
def test_a_lasso_is_that_of_all_sign_patterns(seed):
    what = lasso(seed)
    expected = enumerated(what)
    assert 0 < np.count_nonzero(expected) < 5
    method, _ = method_of(what)
    x = verified(what, method.solve(np.zeros(5)))
    np.testing.assert_allclose(x, expected, atol=1e-7)
    assert method.steps == 3 * method.newton_steps > 0


def test_steps_that_fall_short_get_there_all_the_same():
    what = lasso(1)
    expected = enumerated(what)
    method, system = method_of(what, size=0.4)
    x = verified(what, method.solve(np.zeros(5)))
    np.testing.assert_allclose(x, expected, atol=1e-7)
    # rounds that did not get there ask for more exact steps, within limits
    assert min(system.asked) < system.rtol == max(system.asked)
    assert min(system.asked) >= 1e-9


def test_steps_that_go_too_far_are_cut():
    what = lasso(2)
    method, _ = method_of(what, size=5.0)
    x = verified(what, method.solve(np.ones(5)))
    np.testing.assert_allclose(x, enumerated(what), atol=1e-7)


def test_given_values_stay_and_their_multipliers_balance():
    """With x₀ = ½ given the rest is a lasso of the other columns."""
    rng = np.random.default_rng(5)
    A, b = rng.normal(size=(9, 4)), rng.normal(size=9)
    what = program(
        [term(A, b), term(np.eye(4)[1:], np.zeros(3), WEIGHT, Absolute(), name="bent")],
        [rows("given", np.eye(4)[:1], [0.5], [0.5])],
    )
    left = program(
        [
            term(A[:, 1:], b - 0.5 * A[:, 0]),
            term(np.eye(3), np.zeros(3), WEIGHT, Absolute(), name="bent"),
        ]
    )
    method, _ = method_of(what)
    found = method.solve(np.array([0.5, 0.0, 0.0, 0.0]))
    x = verified(what, found)
    assert x[0] == 0.5
    np.testing.assert_allclose(x[1:], enumerated(left), atol=1e-7)
    balance = -2.0 * A[:, 0] @ (A @ x - b)
    np.testing.assert_allclose(found.duals.rows["given"], [balance], rtol=1e-6)


@pytest.mark.parametrize("name", ["bent", "proximal term"])
def test_the_anchor_leaves_what_nothing_determines_where_it_was(name, monkeypatch):
    """|x₀ + x₁ − 4| alone: from (9, −1) the proximal point moves along (1, 1).

    By no more than one a round each, for its slope is one: the anchor goes along.
    """
    what = program([term([[1.0, 1.0]], [4.0], 1.0, Absolute(), name=name)])
    monkeypatch.setattr(method_of_multipliers, "GROWTH", 1.0)
    start = np.array([9.0, -1.0])
    method, _ = method_of(what, anchor=start)
    x = verified(what, method.solve(start))
    np.testing.assert_allclose(x, [7.0, -3.0], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "claim"),
    [({"request": Request(1e-9, 1e-9)}, Claim.TIME_LIMIT), ({}, Claim.GAVE_UP)],
    ids=["time", "rounds"],
)
def test_an_end_before_the_tolerance_is_told(change, claim, monkeypatch):
    if not change:
        monkeypatch.setattr(method_of_multipliers, "ROUNDS", 2)
        monkeypatch.setattr(method_of_multipliers, "NEWTON_STEPS", 1)
    what = lasso(0)
    method, _ = method_of(what, **change)
    found = method.solve(np.full(5, 10.0))
    assert found.claim is claim
    assert what.objective(found.x) < what.objective(np.full(5, 10.0))
    assert kkt_residuals(what, found.x, found.duals).worst_relative > 1e-9


@pytest.mark.parametrize(("bent", "most"), [(True, 25), (False, 3)])
def test_the_best_point_on_the_way_is_the_answer(bent, most, monkeypatch):
    """The residual is least in the third round; with nothing better it ends."""
    points = []

    def scripted(what, x, *more, **options):
        points.append(x)
        return SimpleNamespace(worst_relative=[0.5, 0.4, 0.1][min(len(points), 3) - 1])

    monkeypatch.setattr(method_of_multipliers, "kkt_residuals", scripted)
    what = lasso(3)
    if not bent:
        what = replace(what, terms=what.terms[:1])
    method, _ = method_of(what, size=0.5)
    found = method.solve(np.full(5, 10.0))
    assert found.claim is Claim.GAVE_UP
    assert found.x is points[2]
    assert len(points) == 3 + most + 1


def test_a_step_that_is_no_number_changes_nothing():
    class Failing(Dense):
        def step(self, *given):
            d, spent = super().step(*given)
            return np.full_like(d, np.nan), spent

    problem = PenalisedProblem.of(lasso(3))
    method = MethodOfMultipliers(problem, Failing(problem), Request(1e-9))
    found = method.solve(np.full(5, 10.0))
    assert found.claim is Claim.GAVE_UP
    np.testing.assert_array_equal(found.x, np.full(5, 10.0))


def test_parameters_grow_after_a_complete_round_and_shrink_after_another(monkeypatch):
    monkeypatch.setattr(method_of_multipliers, "ROUNDS", 3)
    method, _ = method_of(lasso(0))
    outcomes, growths = iter([True, False, True]), []

    def minimise(state, rtol):
        state.evaluate(method._blocks)
        return next(outcomes)

    monkeypatch.setattr(method, "_minimise", minimise)
    monkeypatch.setattr(method, "_next_round", lambda _, growth: growths.append(growth))
    monkeypatch.setattr(
        method_of_multipliers,
        "kkt_residuals",
        lambda *given, **options: SimpleNamespace(worst_relative=1.0),
    )
    method.solve(np.full(5, 10.0))
    assert growths == [2.0, 1.0 / 1.5, 2.0]


#: Slopes of convex functions, negative at 0 and with their zero before 1
SLOPES = {
    "parabola": lambda s: s - 0.3,
    "near the start": lambda s: 1e3 * (s - 1e-3),
    "near the end": lambda s: s**9 - 0.5,
    "cosh": lambda s: math.sinh(8.0 * (s - 0.7)),
    "kink": lambda s: -1e-3 if s < 0.42 else 50.0 * (s - 0.42) + 1e-3,
    "Huber": lambda s: float(np.clip(30.0 * (s - 0.61), -1.0, 1.0)),
}


@pytest.mark.parametrize("name", SLOPES)
def test_the_slope_nearly_goes(name):
    slope, calls = SLOPES[name], []
    most = method_of_multipliers.EVALUATIONS + 1

    def counted(step):
        calls.append(step)
        return slope(step)

    step, left = line_search(counted, slope(0.0))
    assert 0.0 < step <= 1.0
    assert left == slope(step)
    assert (
        abs(left) <= method_of_multipliers.FLAT * abs(slope(0.0)) or len(calls) == most
    )
    assert len(calls) <= most


def test_a_minimum_beyond_the_end_is_a_whole_step():
    assert line_search(lambda s: s - 2.0, -2.0) == (1.0, -1.0)


def test_a_jump_of_the_slope_is_closed_in_on():
    """Where no slope is small enough the bracket shrinks to the kink."""
    step, _ = line_search(lambda s: -1.0 if s < 0.37 else 1.0, -1.0)
    assert step == pytest.approx(0.37, abs=1e-3)


def test_a_straight_slope_takes_one_secant():
    calls = []

    def slope(step):
        calls.append(step)
        return step - 0.3

    line_search(slope, -0.3)
    assert calls == pytest.approx([1.0, 0.3])
