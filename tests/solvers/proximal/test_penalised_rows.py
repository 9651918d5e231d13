"""Multipliers of penalised rows are the gradient of e(x), their slope its curvature."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import minimize_scalar

from tests.solvers.problems import term
from ttus_opt.problem.terms.penalties import Absolute, Groups, Huber, Squares
from ttus_opt.solvers.proximal.penalised_rows import (
    EXACT,
    Between,
    PenalisedRows,
    group_columns,
)

M, N, WEIGHT = 6, 4, 0.7
LIMITS = Between(
    np.array([-0.5, -np.inf, 0.2, 0, -1, -np.inf]),
    np.array([0.5, 0.3, np.inf, 0, 2, 0]),
)


def block(law, sigma=2.5):
    rng = np.random.default_rng(0)
    matrix = sp.csr_array(rng.normal(size=(M, N)))
    # limits have no weight of their own
    weight = 1.0 if isinstance(law, Between) else WEIGHT
    made = PenalisedRows("own", matrix, rng.normal(size=M), weight, law)
    made.sigma, made.multipliers = sigma, rng.normal(size=M)
    return made


def envelope(of, x):
    """e(x) = min_z w φ(z) + σ/2 ‖r − z + y/σ‖², row by row by a search."""
    total = 0.0
    aim = of.residual(x) + of.multipliers / of.sigma
    for k, at in enumerate(aim):
        if isinstance(of.law, Between):
            z = np.clip(at, of.law.lower[k], of.law.upper[k])
            total += 0.5 * of.sigma * (at - z) ** 2
            continue

        def cost(z, at=at):
            charged = of.law.value(np.array([z]))
            return float(of.weight * charged + 0.5 * of.sigma * (at - z) ** 2)

        found = minimize_scalar(
            cost,
            bounds=(-abs(at) - 0.1, abs(at) + 0.1),
            method="bounded",
            options={"xatol": 1e-12},
        )
        total += min(found.fun, cost(0.0))
    return total


LAWS = [Absolute(), Huber(0.4), Squares(), LIMITS]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_the_gradient_of_the_envelope_is_what_the_multipliers_pull(law):
    own, rng = block(law), np.random.default_rng(1)
    for _ in range(5):
        x, along = rng.normal(size=(2, N))
        y, _ = own.charged(own.residual(x))
        h = 1e-4
        ends = [envelope(own, x + s * h * along) for s in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / (2.0 * h)
        assert own.adjoint(y) @ along == pytest.approx(slope, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("law", [*LAWS, Groups(3)], ids=lambda law: type(law).__name__)
def test_the_slope_is_how_the_multipliers_change(law):
    own, rng = block(law), np.random.default_rng(2)
    for _ in range(5):
        r, along = rng.normal(size=(2, M))
        ends = [own.charged(r + s * 1e-6 * along)[0] for s in (1.0, -1.0)]
        _, slope = own.charged(r)
        np.testing.assert_allclose(
            slope.times(along), (ends[0] - ends[1]) / 2e-6, atol=1e-7
        )


def test_limits_charge_the_excess_alone():
    """g minimises its conjugate: support of [lower, upper], plus (g − v)²/2 step."""
    v, step = np.array([1.0, 0.0, 0.2, -3.0, 7.0, -1.0]), 2.0
    g, slope = LIMITS.resolvent(v, step)
    np.testing.assert_allclose(g, [0.0, 0.0, -0.2, -3.0, 3.0, 0.0])
    np.testing.assert_array_equal(slope.factor, [0, 0, 1, 1, 1, 0])
    assert np.isfinite(g).all()  # where limits are infinite, too


def test_a_smooth_penalty_enters_exactly():
    rng = np.random.default_rng(3)
    for penalty in (Squares(), Huber(0.4)):
        M_ = rng.normal(size=(M, N))
        own = PenalisedRows.of(term(M_, rng.normal(size=M), WEIGHT, penalty))
        assert own.exact and own.sigma == EXACT * WEIGHT
        x = rng.normal(size=N)
        y, _ = own.charged(own.residual(x))
        np.testing.assert_allclose(y, WEIGHT * penalty.subgradient(M_ @ x - own.target))
    assert not PenalisedRows.of(term(M_, np.zeros(M), WEIGHT, Absolute())).exact


def test_values_as_columns_sum_up_groups():
    values = np.arange(1.0, 7.0)
    found = group_columns(values, 3)
    assert found.shape == (6, 2)
    np.testing.assert_array_equal(found.T @ np.ones(6), [6.0, 15.0])
    np.testing.assert_array_equal(found @ [1.0, 10.0], values * [1, 1, 1, 10, 10, 10])
