"""Warnings of a scene: misplaced poses, other units, nothing to be wary of."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.conftest import ellipsoid, presses, small_scene, torso
from ttus_opt.contact.scene import Scene
from ttus_opt.core.errors import MistakeWarning, TtusWarning
from ttus_opt.voxmap.voxmap import Voxmap

SURFACE = torso()
VOXMAP = Voxmap.from_surface(SURFACE, shape=(9, 20, 10))
SHELL = ellipsoid()
TRAJECTORY = presses(SURFACE, 12, np.random.default_rng(0))


def test_a_probe_larger_than_the_patient_is_doubted():
    large = tt.PointShell.sphere(0.4, n_points=100)
    with pytest.warns(TtusWarning) as told:
        Scene.assemble(VOXMAP, large, TRAJECTORY, inner=1.0)
    words = [str(w.message) for w in told if w.category is MistakeWarning]
    assert any(w.startswith("the probe is 0.7") for w in words)
    assert any("the patient 0.2" in w for w in words)


def test_poses_off_the_grid_are_counted():
    position = TRAJECTORY.position.copy()
    position[:3, 2] += 5.0
    with pytest.warns(MistakeWarning, match="3 of 12 poses lie outside"):
        Scene.assemble(VOXMAP, SHELL, replace(TRAJECTORY, position=position))


def test_points_beyond_the_inner_layer_are_counted():
    position = TRAJECTORY.position.copy()
    position[:5, :2] *= 0.3
    with pytest.warns(TtusWarning, match="beyond the inner layer at 0.03 m") as told:
        scene = Scene.assemble(VOXMAP, SHELL, replace(TRAJECTORY, position=position))
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
        Scene.assemble(replace(VOXMAP, surface=wider), SHELL, TRAJECTORY)


def test_no_contact_warns_that_the_fit_is_laplace_only():
    away = replace(TRAJECTORY, position=TRAJECTORY.position * [1.3, 1.3, 1.0])
    with pytest.warns(TtusWarning, match="Laplace field alone"):
        Scene.assemble(VOXMAP, SHELL, away)
