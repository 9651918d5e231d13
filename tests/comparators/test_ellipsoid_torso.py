"""The ellipsoid that is there is found, and its depth."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tests.conftest import ellipsoid, torso
from ttus_opt.comparators.ellipsoid_torso import EllipsoidTorso, fitted_ellipsoid


def test_the_ellipsoid_that_is_there_is_found() -> None:
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


def test_depth_below_a_sphere_is_the_difference_of_radii() -> None:
    made = EllipsoidTorso(surface=torso(), shell=ellipsoid())
    made.centre, made.semi_axes, made.axes = np.zeros(3), np.full(3, 0.1), np.eye(3)
    points = np.array([[0.09, 0.0, 0.0], [0.03, 0.04, 0.0], [0.0, 0.11, 0.02]])
    np.testing.assert_allclose(made.depth(points), 0.1 - np.linalg.norm(points, axis=1))
    assert np.isfinite(made.depth(np.zeros((1, 3)))).all()
