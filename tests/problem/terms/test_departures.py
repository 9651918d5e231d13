"""Departures from a reference: squares, and total variation."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, refuses, small_scene, torso
from ttus_opt.problem.formulation import Formulation, load
from ttus_opt.problem.terms import departures

SCENE = small_scene("trilinear")


def test_tikhonov_pulls_towards_its_reference():
    free = SCENE.voxmap.grid.unflatten(SCENE.laplace.free)
    laplace = SCENE.voxmap.grid.unflatten(SCENE.laplace.solve(SCENE.b))
    for reference, target in (("laplace", laplace), ("zero", np.zeros_like(laplace))):
        options, distance = {"force_weight": 1.0, "reference": reference}, []
        for ridge in (1e-4, 1e-2, 1.0):
            field = tt.fit(SCENE, "tikhonov", ridge=ridge, **options).field
            distance.append(np.linalg.norm((field.values - target)[free]))
        assert distance[0] > distance[1] > distance[2]
    words = "reference must be one of laplace, zero"
    refuses(InputError, words, departures.TikhonovTerm, SCENE, reference="mean")


LONG = small_scene("trilinear", n_poses=20)


@pytest.mark.slow
def test_without_measurements_priors_give_the_laplace_field():
    scene = small_scene("trilinear", shape=(7, 12, 8))
    expected = scene.voxmap.grid.unflatten(scene.laplace.solve(scene.b))
    for name in ("sparse_sources", "total_variation", "volume_weighted", "tikhonov"):
        declared = load(name, scene).with_weights(force=0.0, torque=0.0)
        solution = tt.fit(scene, declared, tolerance=1e-5)
        np.testing.assert_allclose(
            solution.field.values, expected, atol=2e-6, err_msg=name
        )


def test_differences_are_those_of_the_grid():
    """Against plain loops, for every voxel of a small grid."""
    grid = small_scene(shape=(5, 6, 4), n_poses=2).voxmap.grid
    p = np.random.default_rng(0).normal(size=grid.shape)
    found = (departures.difference_rows(grid) @ p.reshape(-1)).reshape(*grid.shape, 3)
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


def test_total_variation_of_a_gradient_is_its_length():
    """A field growing along z has the same isotropic and anisotropic variation."""
    scene = small_scene(shape=(6, 8, 6), n_poses=2)
    grid = scene.voxmap.grid
    values = np.broadcast_to(grid.z / grid.r_step, grid.shape).reshape(-1)
    departure = scene.laplace.solve(scene.b) + values
    for isotropic in (False, True):
        term = departures.TotalVariationTerm(scene, isotropic=isotropic)
        program = Formulation([term]).compile()
        steps = grid.shape[0] * grid.shape[1] * (grid.shape[2] - 1)
        assert program.objective(departure) == pytest.approx(steps)
    assert term.penalty == tt.terms.Groups(3)


def test_isotropic_variation_is_a_cone_program_with_a_certificate():
    """Solved through cvxpy; its multipliers prove it on the program as declared."""
    scene = small_scene("trilinear", shape=(6, 10, 6), n_poses=6)
    options = {"force_weight": 1.0, "torque_weight": 1.0, "variation": 0.01}
    solution = tt.fit(
        scene, "total_variation", solver="cvxpy_clarabel", isotropic=True, **options
    )
    assert solution.field is not None
    assert solution.program.terms[0].penalty == tt.terms.Groups(3)
    lengths = np.linalg.norm(
        solution.duals.terms["total_variation"].reshape(-1, 3), axis=1
    )
    assert lengths.max() <= 1.0 + 1e-9
    boxed = tt.fit(scene, "total_variation", **options)
    # √3 |d|₂ ≥ |d|₁ ≥ |d|₂ orders the two minima
    assert solution.objective <= boxed.objective * (1 + 1e-6)
    assert boxed.objective <= np.sqrt(3.0) * solution.objective * (1 + 1e-6)


def test_a_sector_has_no_differences_beyond_its_sides():
    """θ wraps around a full circle only; the wall's column is nobody's neighbour."""
    voxmap = tt.Voxmap.from_surface(
        torso(), shape=(5, 9, 4), r_inner=0.03, sector=(0.2, 2.6)
    )
    grid = voxmap.grid
    D = departures.difference_rows(grid)
    p = np.zeros(grid.shape)
    p[:, grid.wall :] = 7.0
    across = (D @ p.reshape(-1)).reshape(*grid.shape, 3)[..., 1]
    assert not across.any()
    p = np.broadcast_to(np.arange(9.0)[:, None], grid.shape)
    steps = (D @ p.reshape(-1)).reshape(*grid.shape, 3)[..., 1]
    arc = grid.r * grid.theta_step / grid.r_step
    inner = steps[:, : grid.wall - 1]
    np.testing.assert_allclose(
        inner, np.broadcast_to(1 / arc[:, None, None], inner.shape)
    )
