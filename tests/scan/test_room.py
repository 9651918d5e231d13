"""A person who stands in a room, seen by one camera at the scan's origin (y down)."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import GeometryError, InputError, TtusWarning, refuses
from ttus_opt.scan.frame_estimate import camera_of
from ttus_opt.scan.room import alone_in_room


def person(x=0.0):
    """The front half of a flat trunk with two arms behind its middle, at z = 2 m."""
    angle, y = np.meshgrid(np.linspace(0, np.pi, 50), np.linspace(-0.8, 0.4, 100))
    parts = [(0.17, 0.11, 0.0), (0.045, 0.045, 0.27), (0.045, 0.045, -0.27)]
    return np.concatenate(
        [
            np.stack([x + c + a * np.cos(angle), y, 2 - b * np.sin(angle)], -1)
            for a, b, c in parts
        ]
    ).reshape(-1, 3)


def room():
    u, v = np.meshgrid(np.linspace(-1.5, 1.5, 70), np.linspace(-1.5, 1.1, 70))
    wall = np.stack([u, v, np.full_like(u, 3.5)], -1).reshape(-1, 3)
    floor = np.stack([u, np.full_like(u, 1.1), 2.4 + v * 0.8], -1).reshape(-1, 3)
    return np.concatenate([wall, floor])


@pytest.mark.slow
def test_the_side_that_the_camera_saw_is_the_front():
    axis = tt.Axis.from_cloud(person(), head=[0, -1, 0])
    np.testing.assert_array_equal(camera_of(person()), 0.0)
    assert axis.support is None  # trunk's edges and arms at one depth are no table
    assert axis.rotation[:, 1] @ [0, 0, -1] > 0.99
    assert axis.rotation[:, 2] @ [0, -1, 0] > 0.99
    assert 1.9 < axis.origin[2] < 2.05  # behind the skin, inside the body
    assert camera_of(np.vstack([person(), person() + np.array([0, 0, 0.3])])) is None


def test_who_stands_alone_is_cropped(tmp_path):
    np.save(tmp_path / "room.npy", np.concatenate([room(), person()]))
    with pytest.warns(TtusWarning, match="shows a room: only the body"):
        found = tt.read_cloud(tmp_path / "room.npy")
    assert len(found) > 0.3 * len(person())
    assert np.abs(found[:, 2] - 2).max() < 0.2


def test_the_table_that_a_body_lies_on_stays_with_it(tmp_path):
    rng = np.random.default_rng(0)
    angle, z = np.meshgrid(np.linspace(0, np.pi, 120), np.linspace(-0.3, 0.3, 120))
    trunk = np.stack([0.17 * np.cos(angle), 0.24 * np.sin(angle) - 0.02, z], -1)
    trunk = trunk[trunk[..., 1] > 0]
    u, v = np.meshgrid(np.linspace(-0.45, 0.45, 90), np.linspace(-1.25, 1.25, 250))
    table = np.stack([u, np.zeros_like(u), v], -1)[np.abs(u) + np.abs(v) > 0.3]
    points = np.concatenate([trunk, table]) + rng.normal(0, 0.001, (1, 3))
    whole = tt.Axis.from_cloud(points, head=[0, 0, 1])
    np.save(tmp_path / "wide.npy", points)
    with pytest.warns(TtusWarning, match="shows a room"):
        found = tt.read_cloud(tmp_path / "wide.npy")
    assert np.ptp(found[:, 2]) < 1.3  # of 2.5 m
    axis = tt.Axis.from_cloud(found, head=[0, 0, 1])
    assert axis.support is not None
    np.testing.assert_allclose(axis.origin, whole.origin, atol=0.005)
    np.testing.assert_allclose(axis.rotation, whole.rotation, atol=0.01)


def test_strips_of_floor_are_no_bodies():
    u, v = np.meshgrid(np.linspace(0.2, 1.9, 150), np.linspace(2.5, 3.2, 80))
    height = np.random.default_rng(0).normal(1.1, 0.007, u.shape)
    strips = [np.stack([side * u, height, v], -1).reshape(-1, 3) for side in (-1, 1)]
    points = np.concatenate([person(), *strips])  # too short for a large plane
    found = points[alone_in_room(points)]
    assert np.abs(found[:, 2] - 2).max() < 0.2
    assert len(found) > 0.3 * len(person())


def test_several_bodies_are_named(tmp_path):
    two = np.concatenate([room(), person(-0.6), person(0.6)])
    refuses(GeometryError, "several bodies", alone_in_room, two)
    np.save(tmp_path / "two.npy", two)  # 3 m: no larger than a torso's scan may be
    with pytest.warns(TtusWarning, match="read whole: .*crop it by box="):
        assert len(tt.read_cloud(tmp_path / "two.npy")) == len(two)
    np.save(tmp_path / "larger.npy", 1.2 * two)
    refuses(InputError, "crop it by box=", tt.read_cloud, tmp_path / "larger.npy")
