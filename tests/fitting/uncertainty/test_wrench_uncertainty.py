"""Rows of rendered wrenches against the scene's and the renderer's; sizes by hand."""

import numpy as np

import ttus_opt as tt
from tests.kit import dragged_scene, presses, small_scene, torso
from ttus_opt.fitting.uncertainty.wrench_uncertainty import (
    WrenchUncertainty,
    rendered,
    wrench_rows,
)
from ttus_opt.haptic.field_wrench import wrenches_along

SCENE = small_scene("trilinear")


def field(scene, **parameters):
    rng = np.random.default_rng(0)
    values = rng.normal(size=scene.voxmap.grid.shape)
    return tt.PotentialField(scene.voxmap, values, scene.sampling, parameters)


def test_six_rows_of_a_frame_stand_together():
    poses = presses(torso(), 4, np.random.default_rng(5))
    there = tt.Scene.assemble(
        SCENE.voxmap, SCENE.shell, poses, inner=1.0, sampling="trilinear"
    )
    rows = wrench_rows(field(SCENE), SCENE.shell, poses).toarray()
    N, W = there.N.toarray(), there.W.toarray()
    for t in range(4):
        np.testing.assert_allclose(rows[6 * t : 6 * t + 3], N[3 * t : 3 * t + 3])
        np.testing.assert_allclose(rows[6 * t + 3 : 6 * t + 6], W[3 * t : 3 * t + 3])
    assert abs(rows).sum() > 0.0


def test_drag_is_among_them():
    """A field fitted with friction: the same as its own rows, at the poses' motion."""
    scene = dragged_scene("contact")
    solution = tt.fit(scene, "coulomb_global", force_weight=10.0, torque_weight=1.0)
    own = solution.field
    assert own.parameters["friction_coefficient"] > 0.0
    rows = wrench_rows(own, scene.shell, scene.trajectory)
    wrenches = wrenches_along(own, scene.shell, scene.trajectory)
    expected = np.hstack([wrenches.force, wrenches.torque])
    np.testing.assert_allclose(rendered(own, rows), expected, atol=1e-9)
    plain = tt.PotentialField(own.voxmap, own.values, own.sampling)
    without = rendered(own, wrench_rows(plain, scene.shell, scene.trajectory))
    assert np.abs(without - expected).max() > 1e-3


def test_deviations_are_roots_of_the_diagonal():
    roots = np.random.default_rng(1).normal(size=(3, 6, 6))
    covariance = roots @ roots.transpose(0, 2, 1)
    covariance[1] = np.nan
    noise = np.tile(np.diag([0.01, 0.04, 0.09, np.nan, np.nan, np.nan]), (3, 1, 1))
    told = WrenchUncertainty(covariance, noise)
    np.testing.assert_array_equal(told.known, [True, False, True])
    np.testing.assert_allclose(told.force[0], np.linalg.norm(roots[0, :3], axis=1))
    np.testing.assert_allclose(told.torque[2], np.linalg.norm(roots[2, 3:], axis=1))
    assert told.force_size[0] ** 2 == np.trace(covariance[0, :3, :3])
    np.testing.assert_allclose(
        told.torque_size[2] ** 2, np.trace(covariance[2, 3:, 3:])
    )
    np.testing.assert_allclose(told.force_noise[0], [0.1, 0.2, 0.3])
    assert np.isnan(told.torque_noise).all()
