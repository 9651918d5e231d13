"""Conjugate gradients of the dual system against its dense solution."""

import numpy as np
import pytest

from tests.kit import InputError, NumericalError, refuses, small_scene
from ttus_opt.fitting.recursion import dual_recursion
from ttus_opt.fitting.recursion.dual_recursion import FIELD_RTOL, DualRecursion
from ttus_opt.fitting.recursion.measured_rows import Block
from ttus_opt.laplace.system import LaplaceSystem

#: Rows per block in these tests
HEIGHT = 3


class Problem:
    """Random local rows on a small torso, and eq. 10 by explicit dense Q."""

    def __init__(self, scene, n_blocks, seed, weight):
        rng = np.random.default_rng(seed)
        self.scene = scene
        self.blocks, rows = [], []
        for _ in range(n_blocks):
            voxels = np.sort(rng.choice(scene.n_voxels, 9, replace=False))
            values = rng.normal(size=(9, HEIGHT)) * np.sqrt(weight)
            self.blocks.append(Block(voxels.astype(np.int32), values))
            part = np.zeros((HEIGHT, scene.n_voxels))
            part[:, voxels] = values.T
            rows.append(part)
        self.D = np.array(rows)
        self.targets = rng.normal(size=(n_blocks, HEIGHT)) * 3.0 * np.sqrt(weight)

    def start(self):
        scene = self.scene
        return DualRecursion(scene.laplace, scene.b, height=HEIGHT)

    def fold(self, system, which):
        for s in which:
            system.append(system.forecast(self.blocks[s]), self.targets[s])

    def dense(self, which, weights=None):
        """Q and p of the blocks, each with a weight of its own."""
        L = self.scene.L.toarray()
        w = np.ones(len(which)) if weights is None else weights
        D = np.concatenate(
            [self.D[s] * np.sqrt(v) for s, v in zip(which, w, strict=True)]
        )
        t = np.concatenate(
            [self.targets[s] * np.sqrt(v) for s, v in zip(which, w, strict=True)]
        )
        Q = L.T @ L + D.T @ D
        return Q, np.linalg.solve(Q, L.T @ self.scene.b + D.T @ t)


@pytest.fixture(scope="module")
def coarse():
    return small_scene(shape=(7, 12, 7), n_poses=2)


def close(a, b, tolerance=1e-8):
    return bool(np.linalg.norm(a - b) <= tolerance * np.linalg.norm(b))


def test_forecast_after_a_removal_is_the_dense_posterior(coarse):
    """The blocks that were there first go; the same ones once more take their part."""
    problem = Problem(coarse, 4, 10, 1.0)
    system = problem.start()
    problem.fold(system, [0, 1, 0, 1, 2, 2])
    system.remove(0, 2)
    forecast = system.forecast(problem.blocks[3])
    Q, p = problem.dense([0, 1, 2, 2])
    h = problem.D[3]
    covariance = np.eye(HEIGHT) + h @ np.linalg.solve(Q, h.T)
    np.testing.assert_allclose(forecast.schur, covariance, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(forecast.mean, h @ p, atol=1e-6 * np.abs(h @ p).max())
    again = system.forecast(problem.blocks[0])  # of what is held
    h = problem.D[0]
    covariance = np.eye(HEIGHT) + h @ np.linalg.solve(Q, h.T)
    np.testing.assert_allclose(again.schur, covariance, rtol=1e-6, atol=1e-8)


def test_whitened_innovations_carry_the_least_objective(coarse):
    problem = Problem(coarse, 5, 2, 1.0)
    system = problem.start()
    problem.fold(system, list(range(5)))
    _, p = problem.dense(list(range(5)))
    misfit = problem.D.reshape(-1, coarse.n_voxels) @ p - problem.targets.reshape(-1)
    objective = np.sum((coarse.L @ p - coarse.b) ** 2) + np.sum(misfit**2)
    assert system.misfit == pytest.approx(objective, rel=1e-6)


@pytest.mark.parametrize("array", ["_factors", "R"])
def test_a_spoilt_factor_is_made_anew_from_the_rows(coarse, array):
    problem = Problem(coarse, 7, 9, 1.0)
    system = problem.start()
    problem.fold(system, list(range(6)))
    # the sixth block again: others beside the pivots
    problem.fold(system, [5])
    values = getattr(system._kernel, array)
    values[:] = 1e3
    system.remove(6, 1)
    problem.fold(system, [5])
    assert close(system.field(), problem.dense([0, 1, 2, 3, 4, 5, 5])[1])


def test_a_spoilt_factor_is_noticed_by_the_next_rows(coarse):
    """Rows that are said to be known better than they are measured: R is made anew."""
    problem = Problem(coarse, 7, 9, 1e2)
    system = problem.start()
    problem.fold(system, list(range(6)))
    expected = system.forecast(problem.blocks[5]).schur
    system._kernel._factors[:-1] *= 0.5
    np.testing.assert_allclose(
        system.forecast(problem.blocks[5]).schur, expected, rtol=1e-6, atol=1e-9
    )
    problem.fold(system, [5])
    assert close(system.field(), problem.dense([0, 1, 2, 3, 4, 5, 5])[1])


def test_solves_that_fail_leave_what_is_held(coarse, monkeypatch):
    problem = Problem(coarse, 4, 10, 1.0)
    system = problem.start()
    # whatever goes with the first two blocks is known from the next two
    problem.fold(system, [0, 1, 0, 1, 2])

    def fails(*_, **__):
        raise NumericalError("no convergence")

    with monkeypatch.context() as patch:
        patch.setattr(LaplaceSystem, "solve_adjoint", fails)
        system.remove(0, 2)
        assert len(system) == 3
        for call in (system.field, lambda: system.forecast(problem.blocks[3])):
            refuses(NumericalError, "no convergence", call)
        system.remove(2, 1)
        system.fade(0.5)
    _, p = problem.dense([0, 1], np.array([0.5, 0.5]))
    assert close(system.field(), p)
    assert system.forecast(problem.blocks[3]).schur.shape == (HEIGHT, HEIGHT)


def test_rows_that_are_nearly_known_need_no_columns(coarse):
    """Those that differ by 1e-4 have 1e-8 of their variance left, in their noise."""
    problem = Problem(coarse, 3, 11, 1.0)
    rng = np.random.default_rng(11)
    first = problem.blocks[0]
    for s, apart in ((1, 1e-4), (2, 0.5)):
        values = first.values * (1.0 + apart * rng.normal(size=first.values.shape))
        problem.blocks[s] = Block(first.voxels, values)
        problem.D[s] = 0.0
        problem.D[s][:, first.voxels] = values.T
    system, ranks = problem.start(), []
    for s in range(3):
        problem.fold(system, [s])
        ranks.append(system._kernel.rank)
        assert close(system.field(), problem.dense(list(range(s + 1)))[1])
    assert ranks == [HEIGHT, HEIGHT, 2 * HEIGHT]


def test_a_factor_that_is_not_positive_is_made_anew(coarse, monkeypatch):
    problem = Problem(coarse, 4, 12, 1.0)
    system = problem.start()
    problem.fold(system, list(range(4)))
    spoilt, rebuild = system._kernel, system._rebuild
    monkeypatch.setattr(spoilt, "solve", lambda residual: -residual, raising=False)
    rebuilt = []
    monkeypatch.setattr(
        system, "_rebuild", lambda: (rebuilt.append(True), rebuild())[1]
    )
    assert close(system.field(), problem.dense(list(range(4)))[1])
    assert rebuilt == [True]


def test_memory_holds_no_dense_columns():
    scene = small_scene(shape=(12, 40, 24), n_poses=2)
    problem = Problem(scene, 20, 5, 1.0)
    system = problem.start()
    problem.fold(system, list(range(20)))
    # V × rows numbers are what must not be held
    assert system.memory_bytes < 0.3 * 8 * scene.n_voxels * 20 * HEIGHT
    arrays = [v for v in vars(system).values() if isinstance(v, np.ndarray)]
    assert max(a.size for a in arrays) <= scene.n_voxels
    growing = sum(a.nbytes for a in arrays if a.size != scene.n_voxels)
    parts = (system._kernel, system._D, system._basis)
    assert system.memory_bytes == growing + sum(part.memory_bytes for part in parts)


def test_weights_beyond_rounding_are_refused(coarse):
    problem = Problem(coarse, 12, 6, 1e18)
    system = problem.start()
    with pytest.raises(NumericalError, match="weights are too large"):
        problem.fold(system, [*range(12), *range(12)])
        system.field()


def test_refusals(coarse):
    system = Problem(coarse, 1, 8, 1.0).start()
    for factor in (0.0, -0.5, 1.0 + 1e-12, np.nan):
        refuses(InputError, "fading factor", system.fade, factor)


THREE, BLOCKS = 3, 4


def measured(scene, weight, monkeypatch):
    """Random local rows and their misfits, refined without a factor: R = 0."""
    rng, V = np.random.default_rng(12), scene.n_voxels
    system = DualRecursion(scene.laplace, scene.b, height=THREE)
    dense, misfit = np.zeros((BLOCKS * THREE, V)), rng.normal(size=BLOCKS * THREE)
    for s in range(BLOCKS):
        voxels = np.sort(rng.choice(V, 9, replace=False))
        values = rng.normal(size=(9, THREE)) * np.sqrt(weight)
        forecast = system.forecast(Block(voxels.astype(np.int32), values))
        rows = slice(THREE * s, THREE * (s + 1))
        system.append(forecast, forecast.prior + misfit[rows])
        dense[rows, voxels] = values.T
    monkeypatch.setattr(system._kernel, "solve", lambda right_side: right_side)
    return system, dense, misfit


@pytest.mark.parametrize("weight", [1.0, 1e3])
def test_directions_are_conjugate(coarse, weight, monkeypatch):
    """Without a factor: twelve rows in as many steps, and few more for rounding."""
    system, D, d0 = measured(coarse, weight, monkeypatch)
    n = len(d0)
    monkeypatch.setattr(dual_recursion, "FIELD_ROUNDS", n + 4)
    shift = system.field() - system.prior_field
    G = np.linalg.solve(coarse.L.toarray().T, D.T)
    y = np.linalg.solve(np.eye(n) + G.T @ G, d0)
    size = np.linalg.norm(d0)
    np.testing.assert_allclose(system._y, y, atol=2.0 * FIELD_RTOL * size)
    exact = np.linalg.solve(coarse.L.toarray(), G @ y)
    np.testing.assert_allclose(shift, exact, atol=1e-6 * np.abs(exact).max())
    # from there on nothing is left to do
    held, dual = system._shift, system._y
    system.field()
    assert system._shift is held and system._y is dual


def test_too_few_rounds_say_what_is_left(coarse, monkeypatch):
    system, D, d0 = measured(coarse, 1e3, monkeypatch)
    monkeypatch.setattr(dual_recursion, "FIELD_ROUNDS", 2)
    told = system._refined()
    left = np.linalg.norm(d0 - D @ system._shift - system._y) / np.linalg.norm(d0)
    assert told == pytest.approx(left)
    assert left > FIELD_RTOL
    monkeypatch.setattr(dual_recursion, "FIELD_ROUNDS", 0)
    refuses(NumericalError, "dual residual stays at", system.field)
