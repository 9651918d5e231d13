"""Equal pressure and signed distance on blocks, balls and single triangles."""

import numpy as np
import pytest

from tests.comparators.walls import AREA, DEPTH, block, pressed, wall
from ttus_opt.comparators.pressure_field import PressureField, integrated
from ttus_opt.comparators.signed_distance import SignedDistance
from ttus_opt.probe.point_shell import PointShell


def test_signed_distance_gives_a_block_area_times_depth():
    made = SignedDistance(surface=wall(), shell=block())
    unit, _ = made._unit_wrench(*pressed(DEPTH))
    assert unit[0] == pytest.approx(AREA * DEPTH, rel=0.02)
    # opposite sides of the block cancel to the evenness of its points
    np.testing.assert_allclose(unit[1:], 0.0, atol=0.03 * unit[0])


@pytest.mark.parametrize("kind", [PressureField, SignedDistance])
def test_a_pressed_ball_displaces_its_cap(kind):
    """Pressure k d on a rigid body is k times the volume below the surface (Gauss)."""
    radius = 0.02
    made = kind(surface=wall(), shell=PointShell.sphere(radius, n_points=1200))
    for depth in (0.003, 0.008):
        unit, _ = made._unit_wrench(*pressed(depth, half=radius))
        cap = np.pi * depth**2 * (radius - depth / 3.0)
        assert unit[0] == pytest.approx(cap, rel=0.03)
        np.testing.assert_allclose(unit[1:3], 0.0, atol=0.02 * cap)
        np.testing.assert_allclose(unit[3:], 0.0, atol=0.02 * cap * radius)


def test_pressures_are_equal_on_the_contact_surface_like_springs_in_series():
    made = PressureField(surface=wall(), shell=block(), ratio=3.0)
    arm, depth = made._contact_surface(*pressed(DEPTH))
    R, _ = pressed(DEPTH)
    shift = np.linalg.norm(arm - block().points @ R.T, axis=1)
    np.testing.assert_allclose(np.abs(depth), 3.0 * shift, atol=1e-9)
    face = block().normals[:, 2] > 0.99  # below the block: its inward normal is up
    np.testing.assert_allclose(depth[face], 0.75 * DEPTH, rtol=0.02)


def test_triangles_are_integrated_as_by_many_small_ones():
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(6, 3, 3))
    pressure = rng.normal(size=(6, 3))
    n = 400
    u, v = (np.stack(np.meshgrid(np.arange(n), np.arange(n))).reshape(2, -1) + 0.5) / n
    u, v = np.where(u + v > 1.0, (1.0 - u, 1.0 - v), (u, v))
    shares = np.stack([1.0 - u - v, u, v])
    expected = np.zeros(6)
    for x, p in zip(corners, pressure, strict=True):
        value = np.maximum(p @ shares, 0.0)
        into = -0.5 * np.cross(x[1] - x[0], x[2] - x[0])
        force = value[:, None] * into / len(u)
        expected[:3] += force.sum(axis=0)
        expected[3:] += np.cross((x.T @ shares).T, force).sum(axis=0)
    found = integrated(
        corners.reshape(-1, 3), np.arange(18).reshape(6, 3), pressure.ravel()
    )
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())
