"""A probe on the skin against analytic bodies and the deepest of all its points."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import ellipsoid, torso
from ttus_opt.contact.standing import (
    depth_of,
    places_below,
    skin_frames,
    skin_points,
    standing,
    usual_hold,
)

THETA, Z = np.array([0.3, 2.0, 4.0]), np.array([0.05, 0.1, 0.15])


def test_frames_of_the_skin_follow_its_slope():
    theta, z = np.array([0.0, 1.0, 2.5]), np.array([0.1, 0.15, 0.2])
    heights = np.linspace(0.0, 0.3, 31)  # a cone: r = 0.1 + z/4
    cone = tt.Surface.from_radius(np.tile(0.1 + heights / 4.0, (180, 1)), heights)
    frames = skin_frames(cone, theta, z)
    outward = np.stack([np.cos(theta), np.sin(theta), np.full(3, -0.25)], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    np.testing.assert_allclose(frames[:, :, 0], outward, atol=1e-3)
    same = frames.transpose(0, 2, 1) @ frames
    np.testing.assert_allclose(same, np.broadcast_to(np.eye(3), (3, 3, 3)), atol=1e-12)


@pytest.mark.parametrize("depth", [-0.01, 0.0, 0.006, 0.02])
def test_all_points_of_the_probe_count_for_its_depth(depth):
    hold = Rotation.from_rotvec([0.4, -0.3, 1.0]).as_matrix()
    shell = ellipsoid(300, (0.03, 0.0125, 0.018))
    rotation, position = standing(torso(), shell, hold, THETA, Z, depth)
    for R, x in zip(rotation, position, strict=True):
        points = shell.points @ R.T + x
        angle = np.arctan2(points[:, 1], points[:, 0])
        skin = torso().radius_at(angle, points[:, 2])
        deepest = (skin - np.hypot(points[:, 0], points[:, 1])).max()
        assert deepest == pytest.approx(depth, abs=1e-6)


def test_a_ball_on_a_cylinder_stands_one_radius_off():
    cylinder = tt.Surface.from_radius(np.full((360, 5), 0.1), np.linspace(0.0, 0.3, 5))
    ball = ellipsoid(1200, (0.02, 0.02, 0.02))
    rotation, position = standing(cylinder, ball, np.eye(3), THETA, Z, 0.004)
    off = np.linalg.norm(position[:, :2], axis=1)
    # the ball's points are not everywhere
    np.testing.assert_allclose(off, 0.1 + 0.02 - 0.004, atol=1e-4)
    np.testing.assert_allclose(position[:, 2], Z, atol=1e-12)
    depth = depth_of(cylinder, ball, rotation, position)
    np.testing.assert_allclose(depth, 0.004, atol=1e-6)


def shifted():
    """A probe whose frame's origin lies far from it."""
    one, off = ellipsoid(), np.array([0.05, -0.2, 0.1])
    return tt.PointShell(one.points + off, one.normals, one.areas, one.reference + off)


def test_the_usual_hold_is_that_of_the_poses_wherever_the_origin_lies():
    hold = Rotation.from_rotvec([0.2, 0.1, -2.0]).as_matrix()
    for shell in (ellipsoid(), shifted()):
        rotation, position = standing(torso(), shell, hold, THETA, Z, 0.0)
        found = usual_hold(torso(), shell, rotation, position)
        np.testing.assert_allclose(found, hold, atol=1e-5)


def test_the_origin_does_not_change_where_a_probe_stands():
    hold = Rotation.from_rotvec([0.2, 0.1, -2.0]).as_matrix()
    shells = ellipsoid(), shifted()
    poses = [standing(torso(), one, hold, THETA, Z, 0.003) for one in shells]
    places = [R @ one.reference + x for one, (R, x) in zip(shells, poses, strict=True)]
    np.testing.assert_allclose(*places, atol=1e-6)


@pytest.mark.parametrize("height", [-0.01, 0.0, 0.03])
def test_the_place_below_a_point_is_that_of_its_normal(height):
    normal = skin_frames(torso(), THETA, Z)[:, :, 0]
    points = skin_points(torso(), THETA, Z) + height * normal
    theta, z = places_below(torso(), points)
    np.testing.assert_allclose(theta % (2 * np.pi), THETA, atol=1e-5)
    np.testing.assert_allclose(z, Z, atol=1e-6)


def test_points_of_the_skin_lie_on_it():
    points = skin_points(torso(), THETA, Z)
    radius = torso().radius_at(THETA, Z)
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), radius)
    np.testing.assert_allclose(np.arctan2(*points.T[1::-1]) % (2 * np.pi), THETA)
