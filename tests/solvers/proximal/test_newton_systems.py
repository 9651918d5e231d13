"""Newton steps by all ways against dense algebra: H d = −g on what is not given."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.arrays import Array
from ttus_opt.problem import formulation
from ttus_opt.solvers.proximal import field_newton
from ttus_opt.solvers.proximal.field_newton import FieldNewton
from ttus_opt.solvers.proximal.laplace_newton import LaplaceNewton
from ttus_opt.solvers.proximal.problem import PenalisedProblem
from ttus_opt.terms.penalties.base import Slope

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=3)
RTOL = 1e-10


@functools.cache
def problem_of(name: str) -> PenalisedProblem:
    weights = {"force_weight": 0.3, "torque_weight": 0.1}
    program = formulation.load(name, SCENE, **weights).compile()
    return PenalisedProblem.of(program.declared or program)


def slopes_of(problem: PenalisedProblem, seed: int, bent: float) -> list[Slope]:
    """Slopes as kinks leave them: some rows have none."""
    rng = np.random.default_rng(seed)
    slopes = []
    for block in problem.blocks:
        m = len(block.target)
        factor = 2.0 * block.weight * rng.uniform(0.5, 2.0, m)
        if not block.exact:
            factor *= rng.uniform(size=m) >= bent
        slopes.append(Slope(factor))
    return slopes


def expected(
    problem: PenalisedProblem, slopes: Sequence[Slope], gradient: Array
) -> Array:
    """−H⁻¹g by dense algebra."""
    n = len(problem.fixed)
    H = np.zeros((n, n))
    for block, slope in zip(problem.blocks, slopes, strict=True):
        M = block.matrix.toarray()
        C = np.column_stack([slope.times(unit) for unit in np.eye(len(M))])
        H += M.T @ C @ M
    free = np.flatnonzero(~problem.fixed)
    d = np.zeros(n)
    d[free] = np.linalg.solve(H[np.ix_(free, free)], -gradient[free])
    return d


def none_of(problem: PenalisedProblem) -> list[Array]:
    """No multipliers: the gradient is all there is."""
    return [np.zeros(len(b.target)) for b in problem.blocks]


def compared(step: Array, exact: Array) -> None:
    np.testing.assert_allclose(step, exact, atol=1e-7 * np.abs(exact).max())


def gradient_of(problem: PenalisedProblem) -> Array:
    return np.random.default_rng(3).normal(size=len(problem.fixed))


@pytest.mark.parametrize("name", ["robust", "sparse_sources"])
@pytest.mark.parametrize("bent", [0.0, 0.4, 1.0])
def test_through_the_dual(name: str, bent: float) -> None:
    """Few rows may all have bent; of Laplace's rows it is squares that are meant."""
    problem = problem_of(name)
    slopes = slopes_of(problem, 0, bent)
    for k, rows in enumerate(problem.declared):
        if rows is not None:
            factor = slopes[k].factor
            slopes[k] = Slope(np.where(factor > 0.0, factor, factor.max() + 1e-2))
    system = LaplaceNewton(
        SCENE.laplace, problem.blocks, problem.declared, problem.fixed
    )
    gradient = gradient_of(problem)
    step, _ = system.step(gradient, none_of(problem), slopes, RTOL, None)
    compared(step, expected(problem, slopes, gradient))


def test_heavy_rows_balance_the_others() -> None:
    """A rough step is rough beside the step, not beside what heavy rows pull at."""
    problem = problem_of("robust")
    slopes = slopes_of(problem, 0, 0.0)
    few = [k for k, rows in enumerate(problem.declared) if rows is None]
    for k in few:
        slopes[k] = Slope(1e8 * slopes[k].factor)
    system = LaplaceNewton(
        SCENE.laplace, problem.blocks, problem.declared, problem.fixed
    )
    rng, x = np.random.default_rng(8), np.zeros(len(problem.fixed))
    residuals = [rng.normal(size=len(b.target)) for b in problem.blocks]
    for k, rows in enumerate(problem.declared):
        if rows is not None:
            residuals[k][:] = 0.0
    first = None
    for _ in range(2):  # the second one mends what the first left
        y = [
            s.factor * (r + b.matrix @ x)
            for b, s, r in zip(problem.blocks, slopes, residuals, strict=True)
        ]
        gradient = np.sum(
            [b.adjoint(own) for b, own in zip(problem.blocks, y, strict=True)], axis=0
        )
        exact = expected(problem, slopes, gradient)
        step, _ = system.step(gradient, y, slopes, 1e-4, None)
        system.taken(1.0)
        first = exact if first is None else first
        np.testing.assert_allclose(step, exact, atol=1e-3 * np.abs(first).max())
        x = x + step
        assert gradient @ step < 0.0


@pytest.mark.parametrize("how", ["factor", "diagonal", "multigrid"])
@pytest.mark.parametrize("name", ["total_variation", "robust"])
def test_over_the_field(name: str, how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of(name)
    slopes = slopes_of(problem, 1, 0.05)
    if how != "factor":
        monkeypatch.setattr(field_newton, "SMALL", 0)
    monkeypatch.setattr(field_newton, "FEW_ROWS", 50)  # what lies over all voxels here
    monkeypatch.setattr(field_newton, "MOST_STEPS", 2000)
    system = FieldNewton(problem, None)
    system._by_multigrid = how == "multigrid"
    gradient = gradient_of(problem)
    step, steps = system.step(gradient, none_of(problem), slopes, RTOL, None)
    compared(step, expected(problem, slopes, gradient))
    assert (steps == 1) == (how == "factor")


def test_many_steps_ask_for_another_preconditioner(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(field_newton, "SMALL", 0)
    monkeypatch.setattr(field_newton, "FEW_ROWS", 50)
    monkeypatch.setattr(field_newton, "MANY", 12)
    problem = problem_of("total_variation")
    slopes = slopes_of(problem, 2, 0.05)
    system, gradient = FieldNewton(problem, None), gradient_of(problem)
    _, by_diagonal = system.step(gradient, none_of(problem), slopes, 1e-6, None)
    assert by_diagonal > field_newton.MANY
    _, by_multigrid = system.step(gradient, none_of(problem), slopes, 1e-6, None)
    assert by_multigrid < by_diagonal


def test_groups_are_no_longer_stiff_along_their_length(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(field_newton, "SMALL", 0)
    monkeypatch.setattr(field_newton, "MOST_STEPS", 2000)
    problem = problem_of("total_variation")
    slopes = slopes_of(problem, 4, 0.0)
    at = next(k for k, b in enumerate(problem.blocks) if not b.exact)
    factor = np.repeat(slopes[at].factor[::3], 3)
    along = np.random.default_rng(5).normal(size=(len(factor) // 3, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    slopes[at] = Slope(factor, along.reshape(-1), 3)
    gradient = gradient_of(problem)
    step, _ = FieldNewton(problem, None).step(
        gradient, none_of(problem), slopes, RTOL, None
    )
    compared(step, expected(problem, slopes, gradient))
