"""What a scene warns of, and contacts that reach beyond the grid."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import (
    MistakeWarning,
    TtusWarning,
    ellipsoid,
    presses,
    small_scene,
    torso,
)
from ttus_opt.cli.evaluate_command import warn_of_poses
from ttus_opt.contact.scene_warnings import cut_off

#: Radius and height of the body, and of the ball pressed against it [m]
RADIUS, HEIGHT, BALL = 0.1, 0.2, 0.02


def ball():
    return tt.PointShell.sphere(BALL, n_points=400)


def body(sector=None):
    z = np.linspace(0.0, HEIGHT, 9)
    surface = tt.Surface.from_radius(np.full((72, 9), RADIUS), z)
    return tt.Voxmap.from_surface(surface, shape=(12, 24, 12), sector=sector)


def pressed(angles, heights):
    """The ball, 5 mm deep."""
    a = np.radians(angles)
    r = RADIUS + BALL - 0.005
    at = np.stack([r * np.cos(a), r * np.sin(a), np.array(heights)], axis=1)
    return np.tile(np.eye(3), (len(at), 1, 1)), at


def test_a_side_of_the_sector_cuts_contacts_across_it_alone():
    voxmap = body((np.radians(40.0), np.radians(140.0)))
    angles = [90.0, 50.0, 41.0, 139.0, 39.0, 30.0, 270.0]
    found = cut_off(voxmap, ball(), *pressed(angles, [0.1] * 7))
    assert found.tolist() == [False, False, True, True, True, False, False]


def test_so_does_an_end_of_the_grid():
    heights = [0.1, 0.001, 0.199, 0.03, -0.03]
    found = cut_off(body(), ball(), *pressed([90.0] * 5, heights))
    assert found.tolist() == [False, True, True, False, False]
    above = pressed([90.0], [0.001])
    above[1][0, 1] += 0.01  # in the air
    assert not cut_off(body(), ball(), *above).any()


def test_an_assembly_tells_of_them():
    rotation, position = pressed([90.0, 41.0], [0.1, 0.1])
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


SURFACE = torso()
VOXMAP = tt.Voxmap.from_surface(SURFACE, shape=(9, 20, 10))
SHELL = ellipsoid()
TRAJECTORY = presses(SURFACE, 12, np.random.default_rng(0))


def test_a_probe_larger_than_the_patient_is_doubted():
    large = tt.PointShell.sphere(0.4, n_points=100)
    with pytest.warns(TtusWarning) as told:
        tt.Scene.assemble(VOXMAP, large, TRAJECTORY, inner=1.0)
    words = [str(w.message) for w in told if w.category is MistakeWarning]
    assert any(w.startswith("the probe is 0.7") for w in words)
    assert any("the patient 0.2" in w for w in words)


def test_poses_off_the_grid_are_counted():
    position = TRAJECTORY.position.copy()
    position[:3, 2] += 5.0
    with pytest.warns(MistakeWarning, match="3 of 12 poses lie outside"):
        tt.Scene.assemble(VOXMAP, SHELL, replace(TRAJECTORY, position=position))


def test_points_beyond_the_inner_layer_are_counted():
    position = TRAJECTORY.position.copy()
    position[:5, :2] *= 0.3
    with pytest.warns(TtusWarning, match="beyond the inner layer at 0.03 m") as told:
        scene = tt.Scene.assemble(VOXMAP, SHELL, replace(TRAJECTORY, position=position))
    points = np.einsum("tij,mj->tmi", TRAJECTORY.rotation, SHELL.points)
    points += position[:, None]
    r = np.hypot(points[..., 0], points[..., 1])
    np.testing.assert_array_equal(scene.rows.beyond_inner, (r < 0.03).sum(axis=1))
    assert (scene.rows.beyond_inner[:5] > 0).all()
    words = str(told[0].message)
    assert words.startswith(f"5 of 12 poses press shell points ({(r < 0.03).sum()} in")


def test_a_good_scene_warns_of_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        small_scene.__wrapped__()  # not one that another test has made


def test_regions_of_another_surface_warn():
    wider = replace(SURFACE, radius=SURFACE.radius + 0.4 * VOXMAP.grid.r_step)
    with pytest.warns(TtusWarning, match="region is not that of the surface"):
        tt.Scene.assemble(replace(VOXMAP, surface=wider), SHELL, TRAJECTORY)


def test_no_contact_warns_that_the_fit_is_laplace_only():
    away = replace(TRAJECTORY, position=TRAJECTORY.position * [1.3, 1.3, 1.0])
    with pytest.warns(TtusWarning, match="Laplace field alone"):
        tt.Scene.assemble(VOXMAP, SHELL, away)
