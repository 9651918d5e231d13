"""The ellipsoid that is there is found, and its depth."""

import numpy as np
from scipy.spatial.transform import Rotation

from tests.comparators.contacts import made as on_torso
from tests.kit import ellipsoid, torso
from ttus_opt.comparators.ellipsoid_torso import EllipsoidTorso, fitted_ellipsoid


def test_the_ellipsoid_that_is_there_is_found():
    rng = np.random.default_rng(5)
    unit = rng.normal(size=(800, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    turn = Rotation.from_rotvec([0.1, 0.2, -0.1]).as_matrix()
    semi = np.array([0.12, 0.09, 0.3])
    cloud = (unit * semi) @ turn.T + [0.01, -0.02, 0.1]
    centre, found, axes = fitted_ellipsoid(cloud)
    np.testing.assert_allclose(centre, [0.01, -0.02, 0.1], atol=1e-6)
    shape = axes @ np.diag(found**2) @ axes.T
    np.testing.assert_allclose(shape, turn @ np.diag(semi**2) @ turn.T, atol=1e-7)


def test_of_an_open_torso_the_ellipsoid_is_longer_than_the_cloud():
    unit = np.random.default_rng(6).normal(size=(2000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    cloud = unit * [0.12, 0.09, 0.4]
    cloud = cloud[np.abs(cloud[:, 2]) < 0.1]
    _, semi, _ = fitted_ellipsoid(cloud)
    assert semi.max() > np.ptp(cloud, axis=0).max()
    np.testing.assert_allclose(np.sort(semi), [0.09, 0.12, 0.4], rtol=1e-4)


def test_depth_below_a_sphere_is_the_difference_of_radii():
    made = on_torso(EllipsoidTorso)
    made.centre, made.semi_axes, made.axes = np.zeros(3), np.full(3, 0.1), np.eye(3)
    points = np.array([[0.09, 0.0, 0.0], [0.03, 0.04, 0.0], [0.0, 0.11, 0.02]])
    np.testing.assert_allclose(made.depth(points), 0.1 - np.linalg.norm(points, axis=1))
    assert np.isfinite(made.depth(np.zeros((1, 3)))).all()


def test_a_stiffness_of_one_pushes_each_point_by_its_depth_and_area():
    """Point by point, where the probe is half inside a sphere."""
    shell = ellipsoid()
    made = EllipsoidTorso(surface=torso(), shell=shell)
    made.centre, made.semi_axes, made.axes = np.zeros(3), np.full(3, 0.1), np.eye(3)
    R, at = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), np.array([0.1, 0.0, 0])
    force, torque, touched = np.zeros(3), np.zeros(3), 0
    for point, normal, area in zip(
        shell.points, shell.normals, shell.areas, strict=True
    ):
        depth = 0.1 - np.linalg.norm(R @ point + at)
        if depth > 0.0:
            push = depth * area * (R @ normal)
            force += push
            torque += np.cross(R @ (point - shell.reference), push)
            touched += 1
    wrench, points = made._unit_wrench(R, at)
    assert points == touched and 0 < touched < len(shell)
    np.testing.assert_allclose(wrench[:3], force, rtol=1e-9)
    np.testing.assert_allclose(wrench[3:], torque, atol=1e-9 * np.abs(torque).max())
