"""Terms whose residual is no sum of squares, by hand and on small scenes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.conftest import small_scene
from ttus_opt.errors import InputError
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.formulation import Formulation, load
from ttus_opt.terms.penalties.groups import Groups
from ttus_opt.terms.robust_force import RobustForceTerm
from ttus_opt.terms.sparse_sources import SparseSourcesTerm
from ttus_opt.terms.total_variation import TotalVariationTerm, difference_rows

SCENE = small_scene("trilinear", n_poses=20)


@pytest.mark.slow
def test_huber_with_a_wide_limit_is_eq10() -> None:
    plain = fit(SCENE, "eq10", force_weight=0.1, torque_weight=0.1)
    wide = fit(SCENE, "robust", force_weight=0.1, torque_weight=0.1, limit=1e3)
    size = np.abs(plain.field.values).max()
    np.testing.assert_allclose(
        wide.field.values, plain.field.values, rtol=0, atol=1e-5 * size
    )
    assert wide.objective == pytest.approx(plain.objective, rel=1e-6)


def test_huber_bends_less_than_squares_to_an_outlier() -> None:
    """One frame with a slip of 50 N: the others keep their fit."""
    truth = SCENE.N @ SCENE.laplace.solve(SCENE.b)
    force = truth.reshape(-1, 3).copy()
    touched = int(np.argmax(np.linalg.norm(force, axis=1)))
    bad = force.copy()
    bad[touched] += 50.0
    trajectory = replace(
        SCENE.trajectory, force=bad, torque=np.zeros_like(SCENE.trajectory.torque)
    )
    scene = replace(SCENE, trajectory=trajectory)
    others = np.delete(np.arange(len(force)), touched)

    def missed(name: str, **options: float) -> float:
        solution = fit(scene, name, force_weight=1.0, torque_weight=0.0, **options)
        rendered = (scene.N @ solution.field.values.reshape(-1)).reshape(-1, 3)
        return float(np.abs(rendered - force)[others].max())

    assert missed("robust", limit=0.1) < 0.2 * missed("eq10")


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan"), float("inf")])
def test_a_limit_that_is_none_is_refused(limit: float) -> None:
    with pytest.raises(InputError, match="limit must be positive"):
        RobustForceTerm(SCENE, 1.0, limit)


@pytest.mark.slow
def test_sparse_sources_are_sparse() -> None:
    """Squares spread sources over the voxels, absolute values put them into few."""
    options = {"force_weight": 10.0, "torque_weight": 10.0}
    spread = fit(SCENE, "eq10_hard_boundary", **options)
    few = fit(SCENE, "sparse_sources", sparsity=1e-2, tolerance=1e-7, **options)
    term = SparseSourcesTerm(SCENE).rows()

    def active(field: tt.PotentialField) -> int:
        source = np.abs(term.blocks["p"] @ field.values.reshape(-1) - term.target)
        return int((source > 1e-4 * source.max()).sum())

    assert 0 < active(few.field) < 0.2 * active(spread.field)


@pytest.mark.slow
def test_without_measurements_priors_give_the_laplace_field() -> None:
    scene = small_scene("trilinear", shape=(7, 12, 8))
    expected = scene.voxmap.grid.unflatten(scene.laplace.solve(scene.b))
    for name in ("sparse_sources", "total_variation", "volume_weighted", "tikhonov"):
        declared = load(name, scene).with_weights(force=0.0, torque=0.0)
        solution = fit(scene, declared, tolerance=1e-5)
        np.testing.assert_allclose(
            solution.field.values, expected, atol=2e-6, err_msg=name
        )


def test_differences_are_those_of_the_grid() -> None:
    """Against plain loops, for every voxel of a small grid."""
    grid = small_scene(shape=(5, 6, 4), n_poses=2).voxmap.grid
    p = np.random.default_rng(0).normal(size=grid.shape)
    found = (difference_rows(grid) @ p.reshape(-1)).reshape(*grid.shape, 3)
    n_r, n_theta, n_z = grid.shape
    for i in range(n_r):
        for j in range(n_theta):
            for k in range(n_z):
                here = p[i, j, k]
                arc = grid.r[i] * grid.theta_step / grid.r_step
                steps = [
                    p[i + 1, j, k] - here if i + 1 < n_r else 0.0,
                    (p[i, (j + 1) % n_theta, k] - here) / arc,
                    (p[i, j, k + 1] - here) * grid.r_step / grid.z_step
                    if k + 1 < n_z
                    else 0.0,
                ]
                np.testing.assert_allclose(found[i, j, k], steps, atol=1e-12)


def test_total_variation_of_a_gradient_is_its_length() -> None:
    """A field growing along z has the same isotropic and anisotropic variation."""
    scene = small_scene(shape=(6, 8, 6), n_poses=2)
    grid = scene.voxmap.grid
    values = np.broadcast_to(grid.z / grid.r_step, grid.shape).reshape(-1)
    departure = scene.laplace.solve(scene.b) + values
    for isotropic in (False, True):
        term = TotalVariationTerm(scene, isotropic=isotropic)
        program = Formulation([term]).compile()
        steps = grid.shape[0] * grid.shape[1] * (grid.shape[2] - 1)
        assert program.objective(departure) == pytest.approx(steps)
    assert term.penalty == Groups(3)


def test_isotropic_variation_is_a_cone_program_with_a_certificate() -> None:
    """Solved through cvxpy; its multipliers prove it on the program as declared."""
    scene = small_scene("trilinear", shape=(6, 10, 6), n_poses=6)
    options = {"force_weight": 1.0, "torque_weight": 1.0, "variation": 0.01}
    solution = fit(
        scene, "total_variation", solver="cvxpy_clarabel", isotropic=True, **options
    )
    assert solution.field is not None
    assert solution.program.terms[0].penalty == Groups(3)
    lengths = np.linalg.norm(
        solution.duals.terms["total_variation"].reshape(-1, 3), axis=1
    )
    assert lengths.max() <= 1.0 + 1e-9
    boxed = fit(scene, "total_variation", **options)
    # √3 |d|₂ ≥ |d|₁ ≥ |d|₂ orders the two minima
    assert solution.objective <= boxed.objective * (1 + 1e-6)
    assert boxed.objective <= np.sqrt(3.0) * solution.objective * (1 + 1e-6)
