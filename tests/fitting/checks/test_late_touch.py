"""A ball pressed a few millimetres deep, by Hertz, on a skin found late by touch."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import MistakeWarning, TtusWarning
from ttus_opt.contact.scene import ScenePlan
from ttus_opt.fitting.checks.late_touch import late_touch
from ttus_opt.fitting.checks.zero_check import on_zero
from ttus_opt.fitting.weights.weight_choice import choice_of, default_model

BALL, RADIUS = 4e-3, 0.08
SHELL = tt.PointShell.from_spec(f"sphere:{BALL}", n_points=200)
PLAN = ScenePlan((30, 24, 20), 0.065, r_outer=0.084, sector=(1.1, 2.04))


@cache
def pressed(late, deepest=2.5e-3, seed=0):
    """Presses from first touch on, which is noticed ``late`` [m] below the skin.

    On a half-space f = k d^1.5, with k of 0.2 N at 2 mm that varies by 10 %.
    """
    rng = np.random.default_rng(seed)
    n, each = 20, 7
    theta = np.repeat(rng.uniform(1.25, 1.9, n), each)
    z = np.repeat(rng.uniform(0.01, 0.05, n), each)
    depth = np.tile(np.linspace(0.05, 1.0, each) * deepest, n)
    r = RADIUS + BALL - depth
    position = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=1)
    out = np.stack([np.cos(theta), np.sin(theta), 0.0 * z], axis=1)
    k = np.repeat(0.2 * rng.lognormal(0.0, 0.1, n), each)
    size = k * ((depth + late) / 2e-3) ** 1.5
    force = size[:, None] * out + rng.normal(0.0, 5e-3, out.shape)
    time = np.arange(len(z)) * 0.1 + 3.0 * np.repeat(np.arange(n), each)
    recorded = tt.Trajectory(time, position, np.tile(np.eye(3), (len(z), 1, 1)), force)
    skin = np.full((90, 13), RADIUS)
    surface = tt.Surface.from_radius(skin, np.linspace(0.0, 0.06, 13))
    return PLAN.build(surface, SHELL, recorded)


@pytest.mark.parametrize("late", [0.6e-3, 0.8e-3])
def test_the_skin_is_raised_to_where_forces_begin(late):
    assert late_touch(pressed(late)) == pytest.approx(late, abs=0.2e-3)


@pytest.mark.parametrize("late", [0.0, 0.2e-3])
def test_nothing_is_told_of_a_skin_that_is_right_or_hardly_wrong(late):
    assert late_touch(pressed(late)) is None


def test_nothing_is_told_of_deep_contacts():
    scene = pressed(0.6e-3, 12e-3)
    assert late_touch(scene) is None


def test_nothing_is_told_where_nothing_touches_or_forces_pull():
    scene = pressed(0.6e-3)
    at = scene.trajectory
    with pytest.warns(MistakeWarning, match="push into the patient"):
        pulled = scene.measuring(replace(at, force=-at.force))
    assert late_touch(pulled) is None
    away = replace(at, position=1.5 * at.position)
    with (
        pytest.warns(MistakeWarning, match="outside the grid"),
        pytest.warns(TtusWarning, match="touches the patient in none"),
    ):
        air = PLAN.build(scene.voxmap.surface, SHELL, away)
    assert late_touch(air) is None


def test_without_forces_the_skin_stays():
    scene = pressed(0.6e-3)
    plan, at = replace(PLAN, inner=1.0), replace(scene.trajectory, force=None)
    scene = plan.build(scene.voxmap.surface, SHELL, at)
    assert on_zero(scene) is scene


def test_it_ends_where_the_grid_does():
    """The highest skin that lies within it."""
    scene = pressed(0.8e-3)
    low = replace(PLAN, r_outer=RADIUS + 0.3e-3)
    close = low.build(scene.voxmap.surface, SHELL, scene.trajectory)
    found = late_touch(close)
    assert found is not None and 0.0 < found < late_touch(scene)


def test_the_default_is_fitted_on_the_raised_skin():
    """And says so; unseen presses err by less than 0.6 of what they did."""
    scene, unseen = pressed(0.6e-3), pressed(0.6e-3, seed=1).trajectory
    with pytest.warns(MistakeWarning, match=r"begin about 0\.\d+ mm above .* is moved"):
        moved = default_model(scene)
    raised = moved.scene.voxmap.surface.radius - RADIUS
    np.testing.assert_allclose(raised, late_touch(scene), atol=1e-12)

    def error(field):
        force = tt.evaluate(field, SHELL, unseen).rendered_force
        sizes = [np.linalg.norm(each, axis=1) for each in (force, unseen.force)]
        return float(np.abs(sizes[0] - sizes[1]).mean())

    better = error(tt.fit(moved.scene, moved.formulation).field)
    worse = error(tt.fit(scene, "depth_map").field)
    assert better < 0.6 * worse


@pytest.mark.parametrize("formulation", ["eq10", "depth_map"])
def test_a_formulation_that_is_asked_for_is_told_and_keeps_the_skin(formulation):
    scene = pressed(0.6e-3)
    said = r"begin about 0\.\d+ mm above .* late\? A fit without a form"
    with pytest.warns(MistakeWarning, match=said) as told:
        assert choice_of("own", scene, formulation).scene is scene
    assert len(told) == 1


def test_a_bias_alone_is_told_of_a_sensor_that_was_not_zeroed():
    """It too makes forces begin above the skin."""
    scene = pressed(0.0)
    air = scene.trajectory.select(slice(0, 20))
    air = replace(
        air,
        time=air.time + 1e3,
        position=1.04 * air.position,
        force=0.0 * air.force,
        segment=air.segment + 1,
    )
    both = tt.Trajectory.concatenate([scene.trajectory, air])
    both = replace(both, force=both.force + np.array([0.0, 0.3, 0.0]))
    biased = PLAN.build(scene.voxmap.surface, SHELL, both)
    with pytest.warns(MistakeWarning, match="was it zeroed") as told:
        choice_of("own", biased, "eq10")
    assert len(told) == 1
