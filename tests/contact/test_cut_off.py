"""Contacts across a side of a sector or an end of the grid."""

import numpy as np
import pytest

import ttus_opt as tt
from ttus_opt.cli.evaluate_command import warn_of_poses
from ttus_opt.contact.cut_off import cut_off
from ttus_opt.core.errors import TtusWarning
from ttus_opt.scan.surface import Surface

#: Radius and height of the body, and of the ball pressed against it [m]
RADIUS, HEIGHT, BALL = 0.1, 0.2, 0.02


def ball():
    return tt.PointShell.sphere(BALL, n_points=400)


def body(sector=None):
    z = np.linspace(0.0, HEIGHT, 9)
    surface = Surface.from_radius(np.full((72, 9), RADIUS), z)
    return tt.Voxmap.from_surface(surface, shape=(12, 24, 12), sector=sector)


def presses(angles, heights):
    """The ball, 5 mm deep."""
    a = np.radians(angles)
    r = RADIUS + BALL - 0.005
    at = np.stack([r * np.cos(a), r * np.sin(a), np.array(heights)], axis=1)
    return np.tile(np.eye(3), (len(at), 1, 1)), at


def test_a_side_of_the_sector_cuts_contacts_across_it_alone():
    voxmap = body((np.radians(40.0), np.radians(140.0)))
    angles = [90.0, 50.0, 41.0, 139.0, 39.0, 30.0, 270.0]
    found = cut_off(voxmap, ball(), *presses(angles, [0.1] * 7))
    assert found.tolist() == [False, False, True, True, True, False, False]


def test_so_does_an_end_of_the_grid():
    heights = [0.1, 0.001, 0.199, 0.03, -0.03]
    found = cut_off(body(), ball(), *presses([90.0] * 5, heights))
    assert found.tolist() == [False, True, True, False, False]
    above = presses([90.0], [0.001])
    above[1][0, 1] += 0.01  # in the air
    assert not cut_off(body(), ball(), *above).any()


def test_an_assembly_tells_of_them():
    rotation, position = presses([90.0, 41.0], [0.1, 0.1])
    recording = tt.Trajectory(np.arange(2.0), position, rotation)
    voxmap = body((np.radians(40.0), np.radians(140.0)))
    with pytest.warns(TtusWarning, match="1 of 2 poses touch .* widen the sector"):
        tt.Scene.assemble(voxmap, ball(), recording)
    tt.Scene.assemble(voxmap, ball(), recording.select(slice(0, 1)))


def test_the_commands_tell_of_them():
    cut = np.array([True, False])
    with pytest.warns(TtusWarning, match="1 of 2 poses touch .* a wider --sector"):
        warn_of_poses(np.ones(2, bool), np.zeros(2, np.int64), cut)
    warn_of_poses(np.ones(2, bool), np.zeros(2, np.int64), np.zeros(2, bool))
