import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.comparators.recordings import facing
from tests.comparators.walls import BLOCK, block, pressed, wall
from tests.kit import ellipsoid, torso
from ttus_opt.comparators.contact_geometry import ContactGeometry, SmoothSurface


@pytest.mark.parametrize("depth", [-0.005, 0.005, 0.02])
def test_depth_is_the_distance_to_the_triangles_of_a_fine_mesh(depth):
    fine = torso(360, 121).points()
    node = np.arange(360 * 121).reshape(360, 121)
    a, b = node[:, :-1], np.roll(node, -1, 0)[:, :-1]
    c, d = node[:, 1:], np.roll(node, -1, 0)[:, 1:]
    faces = np.concatenate(
        [np.stack(corners, -1).reshape(-1, 3) for corners in ((a, b, c), (b, d, c))]
    )
    triangles = fine.reshape(-1, 3)[faces]
    rng = np.random.default_rng(0)
    theta, z = rng.uniform(0.0, 6.28, 20), rng.uniform(0.06, 0.14, 20)
    r = torso().radius_at(theta, z) - depth
    points = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=1)
    _, near = cKDTree(triangles.mean(axis=1)).query(points, k=100)
    distance = [
        np.linalg.norm(
            trimesh.triangles.closest_point(triangles[own], np.tile(x, (100, 1))) - x,
            axis=1,
        ).min()
        for x, own in zip(points, near, strict=True)
    ]
    found, normals = SmoothSurface(torso()).depth(points)
    np.testing.assert_allclose(np.sign(depth) * found, distance, atol=2e-5)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)


def test_a_rough_surface_has_no_seam():
    """Turned by some nodes, it is the same to rounding, at the seam too."""
    rough = 0.1 + 0.003 * np.random.default_rng(0).normal(size=(20, 5))
    points = np.random.default_rng(1).normal(size=(200, 3)) * 0.1 + [0, 0, 0.1]
    z, turn = np.linspace(0.0, 0.2, 5), Rotation.from_rotvec([0, 0, 0.6 * np.pi])
    depth, normals = SmoothSurface(tt.Surface.from_radius(rough, z)).depth(points)
    turned = SmoothSurface(tt.Surface.from_radius(np.roll(rough, 6, 0), z))
    found = turned.depth(turn.apply(points))
    np.testing.assert_allclose(found[0], depth, atol=1e-10)
    np.testing.assert_allclose(found[1], turn.apply(normals), atol=1e-8)


def test_touch_finds_the_points_within_the_radius():
    surface, shell = torso(), ellipsoid()
    R, at = facing(surface, 2.0, 0.11, 0.006)
    touch = ContactGeometry(surface, shell).touch(R, at)
    points = shell.points @ R.T + at
    theta = np.arctan2(points[:, 1], points[:, 0])
    height = np.hypot(points[:, 0], points[:, 1]) - surface.radius_at(
        theta, points[:, 2]
    )
    found = np.zeros(len(shell), dtype=bool)
    found[touch.index] = True
    # spline and bilinear surface differ by less than 0.1 mm
    assert (np.abs(height[found != (height < 0.0)]) < 1e-4).all()
    assert found.any()
    assert touch.patch.depth == pytest.approx(0.006, abs=2e-4)


def test_patch_of_a_block_is_its_face_and_the_rim_of_its_sides():
    R, at = pressed(0.002)
    patch = ContactGeometry(wall(), block()).touch(R, at).patch
    face, rim = BLOCK[0] * BLOCK[1], 2.0 * (BLOCK[0] + BLOCK[1]) * 0.002
    # depth is even on the face and falls to zero on the rim
    area = (face + rim / 2.0) ** 2 / (face + rim / 3.0)
    assert patch.depth == pytest.approx(0.002, rel=0.01)
    assert patch.area == pytest.approx(area, rel=0.05)
    np.testing.assert_allclose(patch.direction, [1.0, 0.0, 0.0], atol=0.03)


def test_a_pressure_pushes_and_turns_as_the_sum_over_points():
    shell = ellipsoid()
    R, at = facing(torso(), 1.0, 0.1, 0.006)
    R = R @ Rotation.from_rotvec([0.4, 0.3, 0.0]).as_matrix()
    touch = ContactGeometry(torso(), shell).touch(R, at)
    expected = np.zeros(6)
    for m, depth in zip(touch.index, touch.depth, strict=True):
        force = depth * shell.areas[m] * (R @ shell.normals[m])
        arm = R @ (shell.points[m] - shell.reference)
        expected += [*force, *np.cross(arm, force)]
    assert np.linalg.norm(expected[3:]) > 0.05 * 0.02 * np.linalg.norm(expected[:3])
    np.testing.assert_allclose(touch.pushed(touch.depth), expected, rtol=1e-9)
    size = np.linalg.norm(expected[:3])
    np.testing.assert_allclose(touch.patch.unit, expected / size, rtol=1e-9)


def test_velocity_at_the_patch_is_that_of_a_turning_body():
    surface, shell = torso(), ellipsoid()
    R, at = facing(surface, 1.0, 0.1, 0.005)
    touch = ContactGeometry(surface, shell).touch(R, at)
    twist = np.array([0.1, 0.2, -0.1, 1.0, -2.0, 0.5])
    expected = twist[:3] + np.cross(twist[3:], touch.patch.centre - at)
    found = touch.patch.velocity(twist, touch.reference, at)
    np.testing.assert_allclose(found, expected)
