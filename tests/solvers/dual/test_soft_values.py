"""Soft values within limits: the equation of their multipliers, solved densely."""

import numpy as np
import pytest

from tests.kit import small_scene
from ttus_opt.problem.formulation import load
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.dual import soft_values
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.soft_values import SoftValues
from ttus_opt.solvers.structured import Structured

SCENE = small_scene("trilinear", shape=(8, 16, 10), n_poses=6)


def data(weight=1.0):
    weights = {"force_weight": weight, "torque_weight": weight}
    return DualData.of(load("free_surface", SCENE, **weights).compile())


def dense(of):
    """L⁻¹ and D."""
    system = of.system
    inverse = np.linalg.inv(SCENE.laplace.L.toarray())
    return inverse, system.root_weights[:, None] * system.rows.toarray()


@pytest.mark.parametrize("weight", [1e-2, 1.0])
def test_held_are_those_of_the_equation_itself(weight):
    """From the minimiser without limits, against Newton's method in dense algebra."""
    of = data(weight)
    inverse, D = dense(of)
    G = D @ inverse
    model = SoftValues(of.system)
    at, compliance = model.voxels, of.system.compliance
    lower = np.zeros(len(at))

    def solved(held):
        own = compliance.copy()
        own[at[held]] = 0.0
        b = of.b.copy()
        b[at[held]] = 0.0
        y = np.linalg.solve(np.eye(len(D)) + (G * own) @ G.T, of.t - G @ b)
        slope = G.T @ y
        return inverse @ (b + own * slope), (of.b + compliance * slope)[at]

    p, natural = solved(np.zeros(len(at), dtype=bool))
    predicted = model.held(p[at], natural, lower)
    held = natural < lower
    while (following := solved(held)[1] < lower).tobytes() != held.tobytes():
        held = following
    assert 0 < held.sum() < len(held)
    assert (natural < lower).sum() != held.sum()
    assert predicted is not None
    assert np.count_nonzero(predicted != held) <= 0.02 * len(held)


@pytest.fixture
def goals(monkeypatch):
    """Size of what every run of conjugate gradients has to solve."""
    asked = []
    plain = soft_values.conjugate_gradients

    def noted(*given):
        asked.append(float(np.linalg.norm(given[1])))
        return plain(*given)

    monkeypatch.setattr(soft_values, "conjugate_gradients", noted)
    return asked


def test_steps_end_where_the_working_set_stays_whatever_its_size(goals):
    model = SoftValues(data().system)
    rng = np.random.default_rng(2)
    p, natural = rng.normal(size=(2, len(model.voxels)))
    lower = np.full(len(p), -0.1)
    held = model.held(p, natural, lower)
    steps = len(goals)
    again = model.held(1e6 * p, 1e6 * natural, 1e6 * lower)
    assert 0 < held.sum() < len(held)
    np.testing.assert_array_equal(again, held)
    assert 1 < steps < soft_values.STEPS
    np.testing.assert_allclose(goals[steps:], 1e6 * np.array(goals[:steps]), rtol=1e-3)


def test_a_free_surface_takes_few_working_sets(monkeypatch):
    program = load("free_surface", SCENE).compile()
    found = Structured().prepare(program, Request(1e-6)).solve()
    # without a model the same answer, and more of them
    monkeypatch.setattr(SoftValues, "held", lambda *_: None)
    other = Structured().prepare(program, Request(1e-6)).solve()
    assert found.claim is other.claim is Claim.DONE
    np.testing.assert_allclose(found.x, other.x, atol=1e-7 * np.abs(other.x).max())
    sets = [int(one.detail.split()[0]) for one in (found, other)]
    assert sets[0] < sets[1]


def test_where_directions_do_not_suffice_nothing_is_predicted(monkeypatch, goals):
    """It is found out once, by one step."""
    monkeypatch.setattr(soft_values, "MOST_DIRECTIONS", 1)
    monkeypatch.setattr(soft_values, "RESIDUAL", 1e-9)
    of = data()
    model = SoftValues(of.system)
    k = len(model.voxels)
    natural = np.random.default_rng(1).normal(size=k)
    for _ in range(2):
        assert model.held(natural, natural, np.zeros(k)) is None
    assert len(goals) == 1
