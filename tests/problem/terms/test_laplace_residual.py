"""The Laplace prior about a depth profile."""

import functools

import numpy as np
import pytest

import ttus_opt as tt
from tests.conftest import small_scene, with_wrenches
from ttus_opt.fitting.weights.tuning import tune
from ttus_opt.problem.solution import Status
from ttus_opt.problem.terms.depth_map_estimate import least_squares_profile
from ttus_opt.problem.terms.depth_profile import DepthProfile, voxel_depths
from ttus_opt.problem.terms.force import ForceTerm
from ttus_opt.problem.terms.laplace_residual import LaplaceResidualTerm
from ttus_opt.problem.terms.torque import TorqueTerm

PROFILE = DepthProfile((1.0, 2.0), (0.8, 0.3))
WEIGHTS = {"force_weight": 2.0, "torque_weight": 0.5}


@functools.cache
def place():
    return small_scene("trilinear", shape=(6, 12, 7), n_poses=8)


def declared(profile):
    force, torque = ForceTerm(place(), 2.0), TorqueTerm(place(), 0.5)
    return tt.Formulation(
        [LaplaceResidualTerm(place(), profile=profile), force, torque]
    )


def dense(mean):
    """Minimum of ‖L (p − φ)‖² + 2 ‖N p − f‖² + ½ ‖(W p − τ)/ℓ‖² by dense algebra."""
    scene = place()
    length = scene.torque_length
    L, N, W = (m.toarray() for m in (scene.L, scene.N, scene.W))
    M = np.vstack([L, np.sqrt(2.0) * N, np.sqrt(0.5) * W / length])
    own = np.sqrt(0.5) * scene.tau / length
    target = np.concatenate([L @ mean, np.sqrt(2.0) * scene.f, own])
    return np.linalg.solve(M.T @ M, M.T @ target)


def profile_at_voxels(profile):
    """φ voxel by voxel, zero on the surface layer."""
    voxmap = place().voxmap
    mean = np.zeros(place().n_voxels)
    for v, depth in enumerate(voxel_depths(voxmap)):
        powers = zip(profile.coefficients, profile.exponents, strict=True)
        size = sum(c * (abs(depth) / 0.01) ** a for c, a in powers)
        if not voxmap.on_surface.ravel()[v]:
            mean[v] = np.sign(depth) * size
    return mean


@pytest.mark.parametrize("solver", ["structured", "clarabel", "closed_form"])
def test_the_answer_is_that_of_dense_normal_equations(solver):
    expected = dense(profile_at_voxels(PROFILE))
    solution = tt.fit(place(), declared(PROFILE), solver=solver)
    assert solution.status is Status.SOLVED
    size = np.abs(expected).max()
    assert np.abs(solution.field.values.ravel() - expected).max() < 1e-5 * size


def test_without_a_profile_it_is_eq10_with_zero_boundary_values():
    nothing = DepthProfile((1.0,), (1e-12,))
    found = tt.fit(place(), declared(nothing)).field.values
    zero = place().with_boundary(0.0, 0.0)
    expected = tt.fit(zero, "eq10", **WEIGHTS).field.values
    assert np.abs(expected).max() > 0.1
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


def test_without_measurements_the_field_is_the_profile():
    term = LaplaceResidualTerm(place(), profile=PROFILE)
    field = tt.fit(place(), tt.Formulation([term])).field.values
    mean = profile_at_voxels(PROFILE)
    assert np.abs(field.ravel() - mean).max() < 1e-6 * np.abs(mean).max()
    surface = place().voxmap.on_surface
    assert np.abs(field[surface]).max() < 1e-6
    assert (field[0] > 1.0).all() and (field[-1] < 0.0).all()


def test_a_profile_that_made_the_forces_is_found():
    scene = place()
    forces = scene.N @ PROFILE(np.maximum(voxel_depths(scene.voxmap), 0.0))
    found = least_squares_profile(with_wrenches(scene, forces))
    coefficients = dict(zip(found.exponents, found.coefficients, strict=True))
    assert coefficients[1.0] == pytest.approx(0.8, rel=1e-6)
    assert coefficients[2.0] == pytest.approx(0.3, rel=1e-6)
    assert coefficients[1.5] == pytest.approx(0.0, abs=1e-6)


def test_the_boundary_scale_is_neither_listed_nor_tuned():
    fitted = tt.Scene.assemble(
        place().voxmap, place().shell, place().trajectory, inner="fit"
    )
    assert "boundary_scale" in tt.fit(fitted, "eq10").parameters
    assert "boundary_scale" not in tt.fit(fitted, "depth_map_residual").parameters
    found = {
        name: {h.name for h in tune(fitted, name).hyperparameters}
        for name in ("eq10", "depth_map_residual")
    }
    assert found["eq10"] - found["depth_map_residual"] == {"boundary_scale"}
    assert not found["depth_map_residual"] - found["eq10"]
