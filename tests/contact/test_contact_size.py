"""The patch's length and what it does: exact patches, Hertz's power, continuity."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import ellipsoid, small_scene
from ttus_opt.benchmark.parts.rendering import numpy_frame
from ttus_opt.contact.contact_size import REFERENCE_LENGTH, patch_factors, patches_of
from ttus_opt.contact.rows import REFERENCE_AREA, contact_rows
from ttus_opt.voxmap.sampling import LEAST_LENGTH

#: A body so large that it is flat under a probe [m]
BODY = 2.0


def flat(shape=(8, 720, 20)):
    surface = tt.Surface.from_radius(
        np.full((720, 21), BODY), np.linspace(0.0, 0.2, 21)
    )
    return tt.Voxmap.from_surface(surface, shape=shape, r_inner=BODY - 0.02)


def ball_of(n_points):
    return ellipsoid(n_points, (0.05, 0.05, 0.05))


def pressed(depths, size):
    at = np.stack([BODY + size - depths, 0 * depths, 0.1 + 0 * depths], axis=1)
    return np.broadcast_to(np.eye(3), (len(depths), 3, 3)), at


def factors_of(voxmap, shell, rotation, position):
    spread = patches_of(voxmap, shell, rotation, position).spread
    return patch_factors(spread, LEAST_LENGTH)


def test_a_ball_presses_a_round_patch_as_long_as_its_width():
    depths = np.array([0.005, 0.009])
    ball = ball_of(2000)
    lengths = REFERENCE_LENGTH / factors_of(flat(), ball, *pressed(depths, 0.05))
    width = 2.0 * np.sqrt(2.0 * 0.05 * depths)
    np.testing.assert_allclose(lengths, np.hypot(LEAST_LENGTH, width), rtol=0.04)


def test_no_contact_and_one_point_are_as_long_as_the_least():
    depths = np.array([-0.001, 1e-7])
    ball = ball_of(2000)
    deepest = ball.points[:, 0].min()  # the first point to touch
    factors = factors_of(flat(), ball, *pressed(depths, -deepest))
    np.testing.assert_allclose(factors, REFERENCE_LENGTH / LEAST_LENGTH)


def test_a_ball_on_a_field_that_grows_with_depth_is_hertz():
    voxmap, ball = flat(), ball_of(2000)
    depths = np.array([0.003, 0.005, 0.009])
    layers = np.repeat(BODY - voxmap.grid.r, voxmap.grid.n_voxels // 8)
    forces = {}
    for sampling in ("trilinear", "contact-size"):
        rows = contact_rows(voxmap, ball, *pressed(depths, 0.05), sampling=sampling)
        forces[sampling] = (rows.N @ layers).reshape(-1, 3)[:, 0]
    displaced = np.pi * depths**2 * (0.05 - depths / 3.0) / REFERENCE_AREA
    np.testing.assert_allclose(forces["trilinear"], displaced, rtol=0.03)
    power = np.polyfit(np.log(depths), np.log(forces["contact-size"]), 1)[0]
    assert power == pytest.approx(1.5, abs=0.08)  # ℓ₀, and a ball is no paraboloid


def test_force_is_continuous_where_points_come_into_contact():
    scene = small_scene("contact-size")
    R, x = scene.trajectory.rotation[0], scene.trajectory.position[0]
    out = x / np.linalg.norm(x)
    steps = np.linspace(0.0, 0.01, 400)
    at = x + np.outer(0.004 - steps, out)
    poses = np.broadcast_to(R, (400, 3, 3)), at
    rows = contact_rows(scene.voxmap, scene.shell, *poses, sampling="contact-size")
    p = np.maximum(-scene.b, 0.0) + scene.laplace.solve(scene.b)
    size = np.linalg.norm((rows.N @ p).reshape(-1, 3), axis=1)
    assert len(np.unique(rows.contact_points)) > 20
    assert np.abs(np.diff(size)).max() < 0.03 * size.max()


def test_frame_rows_and_plain_code_agree():
    scene = small_scene("contact-size")
    values = np.random.default_rng(0).normal(size=scene.voxmap.grid.shape)
    field = tt.PotentialField(scene.voxmap, values, "contact-size")
    renderer = tt.Renderer(field, scene.shell)
    N, W = ((m @ values.ravel()).reshape(-1, 3) for m in (scene.N, scene.W))
    told = scene.trajectory
    for t in range(4):
        wrench = renderer.render(told.rotation[t], told.position[t])
        np.testing.assert_allclose(wrench.force, N[t], rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(wrench.torque, W[t], rtol=1e-9, atol=1e-11)
        plain = numpy_frame(field, scene.shell, told.rotation[t], told.position[t])
        np.testing.assert_allclose(wrench.force, plain[:3], rtol=1e-9, atol=1e-11)
