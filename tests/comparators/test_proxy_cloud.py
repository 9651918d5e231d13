"""The proxy on clouds whose surface is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.comparators.contacts import made as on_torso
from tests.comparators.recordings import facing
from tests.comparators.walls import block, pressed, wall
from tests.kit import InputError, refuses, torso
from ttus_opt.comparators.contact_geometry import ContactGeometry
from ttus_opt.comparators.proxy_cloud import ProxyCloud, mean_tip


def test_the_proxy_on_a_flat_cloud_is_above_the_tip():
    y, z = np.meshgrid(np.arange(-0.05, 0.05, 0.004), np.arange(-0.05, 0.05, 0.004))
    cloud = np.stack([np.full(y.size, 9.0), y.ravel(), z.ravel()], axis=1)
    made = ProxyCloud(
        surface=wall(), shell=block(), cloud=cloud, tip=(0.001, 0.002, -0.01)
    )
    R, at = pressed(0.003)
    unit, touching = made._unit_wrench(R, at)
    assert touching == 1
    np.testing.assert_allclose(unit[:3], [0.003, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(unit[3:], np.cross(R @ made.tip, unit[:3]), atol=1e-12)
    assert made._unit_wrench(*pressed(-0.001))[1] == 0


def ball(radius=0.1, n=4000):
    """A Fibonacci sphere about the origin."""
    k = np.arange(n) + 0.5
    z, angle = 1.0 - 2.0 * k / n, np.pi * (1.0 + 5.0**0.5) * k
    r = np.sqrt(1.0 - z**2)
    return radius * np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def test_on_a_ball_the_force_is_along_the_radius():
    """Weights (1 − ρ²/h²)² have the mean ρ²/2R = h²/8R: so deep lies the plane."""
    made = on_torso(ProxyCloud, cloud=ball(), tip=(0, 0, 0))
    sagged = made.radius**2 / (8.0 * 0.1)
    rng = np.random.default_rng(0)
    for _ in range(5):
        out = rng.normal(size=3) * [1.0, 1.0, 0.2]
        out /= np.linalg.norm(out)
        unit, touching = made._unit_wrench(np.eye(3), 0.094 * out)
        assert touching == 1
        np.testing.assert_allclose(unit[:3], (0.006 - sagged) * out, atol=6e-5)
        np.testing.assert_array_equal(made._unit_wrench(np.eye(3), 0.101 * out)[0], 0.0)


def test_the_plane_is_the_weighted_one():
    """Against a least-squares plane through the same points, by its own equations."""
    rng = np.random.default_rng(1)
    made = on_torso(ProxyCloud, tip=(0.0, 0.0, 0.0))
    place = torso().points()[20, 15] + rng.normal(0.0, 1e-3, 3)
    found = made._plane(place)
    middle, normal = found
    square = ((made.cloud - place) ** 2).sum(axis=1) / made.radius**2
    weights = np.where(square < 1.0, (1.0 - square) ** 2, 0.0)
    np.testing.assert_allclose(middle, weights @ made.cloud / weights.sum())

    def misfit(n):
        return float(weights @ ((made.cloud - middle) @ n) ** 2)

    for _ in range(20):
        other = normal + rng.normal(0.0, 0.05, 3)
        assert misfit(normal) <= misfit(other / np.linalg.norm(other))
    assert normal[:2] @ place[:2] > 0.0
    assert made._plane(np.array([0.0, 5.0, 0.0])) is None


def test_the_tip_is_the_mean_of_contacts_by_area_and_depth():
    """A ball pressed 1 mm with its pole and 5 mm with a point 0.8 rad beside it.

    A cap's area times its mean depth grows with the square of the depth: 1 to 25.
    """
    points, turn = ball(0.02, 6000), 0.8
    areas = np.full(len(points), 4.0 * np.pi * 0.02**2 / len(points))
    shell = tt.PointShell(points, -points / 0.02, areas, np.zeros(3))
    R, at = facing(torso(), 1.5, 0.1, 0.001)
    at = at + 0.005 * R @ [0.0, 0.0, -1.0]  # the ball is 20 mm, not 15
    deeper = at + 0.004 * R @ [0.0, 0.0, 1.0]
    turned = R @ Rotation.from_rotvec([turn, 0.0, 0.0]).as_matrix()
    press = tt.Trajectory(np.arange(2.0), np.stack([at, deeper]), np.stack([R, turned]))
    tip = mean_tip(ContactGeometry(torso(), shell), press)
    assert np.linalg.norm(tip) == pytest.approx(0.02, rel=1e-3)
    assert np.arctan2(tip[1], tip[2]) == pytest.approx(turn * 25.0 / 26.0, abs=0.05)
    away = tt.Trajectory(press.time, 2.0 * press.position, press.rotation)
    refuses(InputError, "in no frame", mean_tip, ContactGeometry(torso(), shell), away)


def test_a_tip_or_radius_that_is_none_is_told():
    refuses(InputError, "tip must be a point", on_torso, ProxyCloud, tip=(0.0, 0.0))
    for radius in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="radius must be positive"):
            on_torso(ProxyCloud, radius=radius)
