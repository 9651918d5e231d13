from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.conftest import small_scene
from ttus_opt import functional_recursion
from ttus_opt.errors import InputError, NumericalError
from ttus_opt.functional_recursion import BUDGET, FunctionalRecursion
from ttus_opt.functionals import Block
from ttus_opt.scene import Scene

Array = NDArray[np.float64]

#: Rows per block in these tests
HEIGHT = 3


class Problem:
    """Random local rows on a small torso, and eq. 10 by explicit dense Q."""

    def __init__(
        self, scene: Scene, n_blocks: int, seed: int, weight: float, size: int = 9
    ) -> None:
        rng = np.random.default_rng(seed)
        self.scene = scene
        self.blocks, rows = [], []
        for _ in range(n_blocks):
            voxels = np.sort(rng.choice(scene.n_voxels, size, replace=False))
            values = rng.normal(size=(size, HEIGHT)) * np.sqrt(weight)
            self.blocks.append(Block(voxels.astype(np.int32), values))
            part = np.zeros((HEIGHT, scene.n_voxels))
            part[:, voxels] = values.T
            rows.append(part)
        self.D = np.array(rows)
        self.targets = rng.normal(size=(n_blocks, HEIGHT)) * 3.0 * np.sqrt(weight)

    def start(self) -> FunctionalRecursion:
        scene = self.scene
        return FunctionalRecursion(scene.laplace, scene.b, height=HEIGHT)

    def fold(self, system: FunctionalRecursion, which: list[int]) -> None:
        for s in which:
            system.append(system.forecast(self.blocks[s]), self.targets[s])

    def dense(
        self, which: list[int], weights: Array | None = None
    ) -> tuple[Array, Array]:
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
def coarse() -> Scene:
    return small_scene(shape=(7, 12, 7), n_poses=2)


def close(a: Array, b: Array, tolerance: float = 1e-8) -> bool:
    return bool(np.linalg.norm(a - b) <= tolerance * np.linalg.norm(b))


@pytest.mark.parametrize("weight", [1e-4, 1.0, 1e4])
def test_field_is_that_of_the_explicit_closed_form(
    coarse: Scene, weight: float
) -> None:
    problem = Problem(coarse, 8, 0, weight)
    system = problem.start()
    assert close(system.field(), coarse.laplace.solve(coarse.b), 1e-12)
    for s in range(8):
        problem.fold(system, [s])
        _, p = problem.dense(list(range(s + 1)))
        assert close(system.field(), p)


def test_forecast_is_the_dense_posterior(coarse: Scene) -> None:
    problem = Problem(coarse, 7, 1, 1.0)
    system = problem.start()
    problem.fold(system, list(range(6)))
    forecast = system.forecast(problem.blocks[6])
    Q, p = problem.dense(list(range(6)))
    h = problem.D[6]
    covariance = np.eye(HEIGHT) + h @ np.linalg.solve(Q, h.T)
    assert np.allclose(forecast.schur, covariance, rtol=1e-6, atol=1e-8)
    assert np.allclose(forecast.mean, h @ p, atol=1e-6 * np.abs(h @ p).max())


def test_misfit_is_the_least_objective(coarse: Scene) -> None:
    problem = Problem(coarse, 5, 2, 1.0)
    system = problem.start()
    problem.fold(system, list(range(5)))
    _, p = problem.dense(list(range(5)))
    misfit = problem.D.reshape(-1, coarse.n_voxels) @ p - problem.targets.reshape(-1)
    objective = np.sum((coarse.L @ p - coarse.b) ** 2) + np.sum(misfit**2)
    assert system.misfit == pytest.approx(objective, rel=1e-6)


@given(
    order=st.permutations(range(5)),
    removed=st.integers(0, 4),
    count=st.integers(1, 3),
    seed=st.integers(0, 1000),
)
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_order_and_any_removal(
    coarse: Scene, order: list[int], removed: int, count: int, seed: int
) -> None:
    problem = Problem(coarse, 5, seed, 1.0)
    system = problem.start()
    problem.fold(system, order)
    assert close(system.field(), problem.dense(list(range(5)))[1])
    count = min(count, 5 - removed)
    system.remove(removed, count)
    left = order[:removed] + order[removed + count :]
    if left:
        assert close(system.field(), problem.dense(left)[1])
    else:
        assert close(system.field(), coarse.laplace.solve(coarse.b))
    # back in again: the identity
    problem.fold(system, order[removed : removed + count])
    assert close(system.field(), problem.dense(list(range(5)))[1])


def test_removing_the_last_returns_the_former_state(coarse: Scene) -> None:
    problem = Problem(coarse, 4, 3, 1.0)
    system = problem.start()
    problem.fold(system, [0, 1, 2])
    misfit = system.misfit
    before = system.forecast(problem.blocks[3])
    system.append(before, problem.targets[3])
    system.remove(3, 1)
    again = system.forecast(problem.blocks[3])
    assert system.misfit == pytest.approx(misfit, rel=1e-10)
    assert close(again.schur, before.schur, 1e-10)
    assert close(again.mean, before.mean, 1e-10)


class Solves:
    """Counts the columns that are solved for."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count = 0
        inverse = FunctionalRecursion._inverse

        def counted(system: FunctionalRecursion, source: Array, rtol: float) -> Array:
            self.count += 1
            return inverse(system, source, rtol)

        monkeypatch.setattr(FunctionalRecursion, "_inverse", counted)

    def since(self) -> int:
        count, self.count = self.count, 0
        return count


def test_poses_beyond_the_budget_resolve_little_by_little(
    coarse: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = Problem(coarse, 6, 9, 1.0, size=40)
    system, solves = problem.start(), Solves(monkeypatch)
    problem.fold(system, [0])
    assert solves.since() == BUDGET
    assert system.n_functionals == BUDGET
    problem.fold(system, [1, 2, 3])
    assert solves.since() == 4 * BUDGET - BUDGET
    assert close(system.field(), problem.dense([0, 1, 2, 3])[1])
    solves.since()
    # the same pose again and again: in the end all its voxels are resolved
    again, left = [0, 1, 2, 3], -(-40 // (BUDGET - HEIGHT))
    for _ in range(left):
        problem.fold(system, [1])
        again.append(1)
        assert solves.since() <= BUDGET
        assert close(system.field(), problem.dense(again)[1])
        solves.since()
    problem.fold(system, [1])
    assert solves.since() == 0
    again.append(1)
    weights = np.full(len(again), 0.5)
    assert not close(system.field(), problem.dense(again, weights)[1])
    system.fade(0.5)
    assert close(system.field(), problem.dense(again, weights)[1])
    # blocks written with tails and with voxels both go, whatever came between
    system.remove(0, 2)
    assert close(system.field(), problem.dense(again[2:], weights[2:])[1])
    for _ in range(3 * left):
        for s in (0, 2, 3):
            problem.fold(system, [s])
    touched = np.unique(np.concatenate([b.voxels for b in problem.blocks[:4]]))
    assert system.n_functionals == len(touched)
    solves.since()
    system.forecast(problem.blocks[0])
    assert solves.since() == 0


def test_fading_blocks_that_have_tails(coarse: Scene) -> None:
    problem = Problem(coarse, 3, 12, 1.0, size=40)
    system = problem.start()
    problem.fold(system, [0, 1])
    system.fade(0.3)
    problem.fold(system, [2])
    held, weights = [0, 1, 2], np.array([0.3, 0.3, 1.0])
    assert close(system.field(), problem.dense(held, weights)[1])
    # one goes while it has its tail
    system.remove(0, 1)
    held, weights = held[1:], weights[1:]
    assert close(system.field(), problem.dense(held, weights)[1])
    # the other's tail goes first, and then it goes
    again = -(-40 // (BUDGET - HEIGHT))
    problem.fold(system, [1] * again)
    held, weights = held + [1] * again, np.append(weights, np.ones(again))
    assert close(system.field(), problem.dense(held, weights)[1])
    system.remove(0, 1)
    assert close(system.field(), problem.dense(held[1:], weights[1:])[1])


def test_a_forecast_that_is_not_taken_in_leaves_no_trace(coarse: Scene) -> None:
    problem = Problem(coarse, 3, 10, 1.0, size=40)
    system = problem.start()
    problem.fold(system, [0])
    for _ in range(3):
        system.forecast(problem.blocks[1])
    assert close(system.field(), problem.dense([0])[1])
    # what was resolved stays, the tail of block 1 does not
    assert system.n_functionals <= BUDGET + 3 * (BUDGET - HEIGHT)
    forecast = system.forecast(problem.blocks[2])
    system.append(forecast, problem.targets[2])
    assert close(system.field(), problem.dense([0, 2])[1])


def test_removing_many_at_once(coarse: Scene) -> None:
    problem = Problem(coarse, 24, 11, 1.0, size=6)
    system = problem.start()
    one_place = [s % 4 for s in range(40)]
    problem.fold(system, one_place)
    system.remove(0, 38)
    assert close(system.field(), problem.dense(one_place[38:])[1])
    system.remove(0, 2)
    assert close(system.field(), coarse.laplace.solve(coarse.b), 1e-14)
    assert system.misfit == 0.0


def test_fading_is_the_batch_with_faded_weights(coarse: Scene) -> None:
    problem = Problem(coarse, 6, 4, 1.0)
    system = problem.start()
    weights = np.ones(0)
    for s in range(6):
        problem.fold(system, [s])
        weights = np.append(weights, 1.0)
        if s in (1, 3, 4):
            system.fade(0.4)
            weights = weights * 0.4
        _, p = problem.dense(list(range(s + 1)), weights)
        assert close(system.field(), p)


def test_memory_is_that_of_the_voxels_touched(coarse: Scene) -> None:
    problem = Problem(coarse, 4, 5, 1.0)
    system = problem.start()
    problem.fold(system, [0, 1, 2, 3])
    functionals, memory = system.n_functionals, system.memory_bytes
    for _ in range(50):
        problem.fold(system, [0, 1, 2, 3])
    assert system.n_functionals == functionals
    # the rows and targets are kept, and nothing else
    rows = 9 * (8 * HEIGHT + 4) + 8 * HEIGHT
    assert system.memory_bytes == memory + 200 * rows


def test_weights_beyond_rounding_are_refused(coarse: Scene) -> None:
    problem = Problem(coarse, 12, 6, 1e18)
    system = problem.start()
    with pytest.raises(NumericalError, match="weights are too large"):
        problem.fold(system, [*range(12), *range(12)])
        system.field()


def test_a_field_that_does_not_converge_is_an_error(
    coarse: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = Problem(coarse, 2, 7, 1.0)
    system = problem.start()
    problem.fold(system, [0, 1])
    monkeypatch.setattr(functional_recursion, "FIELD_RTOL", 0.0)
    with pytest.raises(NumericalError, match="the field still changes"):
        system.field()
    monkeypatch.undo()
    assert close(system.field(), problem.dense([0, 1])[1])


def test_refusals(coarse: Scene) -> None:
    system = Problem(coarse, 1, 8, 1.0).start()
    with pytest.raises(InputError, match="not within"):
        system.remove(0, 1)
    with pytest.raises(InputError, match="fading factor"):
        system.fade(0.0)
    with pytest.raises(InputError, match=r"values of shape \(2, 3\), got \(2, 4\)"):
        system.forecast(Block(np.array([1, 2], dtype=np.int32), np.zeros((2, 4))))
