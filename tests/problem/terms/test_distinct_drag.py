"""Drag that reverses, or lies across the force, against least squares and by motion."""

import functools
from pathlib import Path

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import TtusWarning, with_wrenches
from ttus_opt import example
from ttus_opt.contact.point_drag import point_drag_rows
from ttus_opt.problem.terms.distinct_drag import (
    LEAST_DISTINCT,
    ONE_SENSE,
    distinct_drag,
    distinct_share,
)
from ttus_opt.problem.terms.drag_estimate import estimate_drag


def test_the_share_is_what_least_squares_leaves():
    """Drag less its own projection onto drag of constant sense, a column per place."""
    rng = np.random.default_rng(0)
    place = np.array([0, 0, 0, 0, 1, 1, 1, 2, 2, 2])
    elastic = rng.normal(size=(10, 3)) * rng.uniform(0.1, 3.0, (10, 1))
    drag = rng.normal(size=(10, 3))
    unit = elastic / np.linalg.norm(elastic, axis=1, keepdims=True)
    along = np.abs((drag * unit).sum(axis=1))
    columns = np.zeros((30, 3))
    for t in range(10):
        columns[3 * t : 3 * t + 3, place[t]] = along[t] * unit[t]
    g = drag.ravel()
    rest = g - columns @ np.linalg.lstsq(columns, g, rcond=None)[0]
    share = distinct_share(elastic, drag, place)
    assert share == pytest.approx(rest @ rest / (g @ g))
    # and that is by how much the law of force inflates the variance of μ
    both = np.column_stack([g, columns])
    variance = np.linalg.inv(both.T @ both)[0, 0]
    assert share == pytest.approx(1.0 / (variance * (g @ g)))


def test_reversal_and_sideways_drag_tell_and_constant_sense_does_not():
    push = np.tile([2.0, 0.0, 0.0], (4, 1))
    one, aside = np.zeros(4, dtype=np.int64), np.tile([0.0, 0.5, 0.0], (4, 1))
    sense = np.array([1.0, 1.0, -1.0, -1.0])[:, None]
    assert distinct_share(push, 0.3 * push, one) == 0.0
    assert distinct_share(push, -0.3 * push, one) == 0.0
    assert distinct_share(push, 0.3 * sense * push, one) == 1.0
    assert distinct_share(push, aside, one) == 1.0
    assert distinct_share(push, aside + 0.25 * push, one) == pytest.approx(0.5)
    # the law of force at another place is another one
    assert distinct_share(push, 0.3 * sense * push, np.array([0, 0, 1, 1])) == 0.0
    assert distinct_share(push, 0.0 * push, one) == 0.0
    assert distinct_share(0.0 * push, push, one) == 1.0


@functools.cache
def tube():
    z = np.linspace(0.0, 0.2, 21)
    surface = tt.Surface.from_radius(np.full((60, 21), 0.15), z)
    return tt.Voxmap.from_surface(surface, shape=(12, 60, 21), r_inner=0.12)


#: Of the force over depth, a ball's on a half-space; that of a field is about 2 [–]
EXPONENT = 1.5


def pressed(depth, angles):
    """A ball pressed straight in at several angles, a recording each."""
    along = np.repeat(angles, len(depth))
    r = 0.15 + 0.02 - np.tile(depth, len(angles))
    out = np.stack([np.cos(along), np.sin(along), 0.0 * along], axis=1)
    position = r[:, None] * out + [0.0, 0.0, 0.1]
    size = np.maximum(np.tile(depth, len(angles)) / 0.006, 0.0) ** EXPONENT
    force = 3.0 * size[:, None] * out
    poses = tt.Trajectory(
        0.05 * np.arange(len(r)),
        position,
        np.tile(np.eye(3), (len(r), 1, 1)),
        force,
        0.0 * force,
        segment=np.repeat(np.arange(len(angles)), len(depth)),
    )
    shell = tt.PointShell.sphere(0.02, 700)
    return tt.Scene.assemble(tube(), shell, poses, inner=3.0)


ANGLES = np.array([0.5, 1.2, 2.0])
DOWN = np.linspace(-0.003, 0.006, 15)

#: Depths of a press, and whether it tells friction
MOTIONS = {
    "not released": (DOWN, False),
    "in the air at once": (np.append(DOWN, -0.005), False),
    "only released": (DOWN[::-1], False),
    "released": (np.concatenate([DOWN, DOWN[-2::-1]]), True),
    "half released": (np.concatenate([DOWN, DOWN[-2:-8:-1]]), True),
    "held": (np.concatenate([DOWN, np.full(15, 0.006)]), False),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_a_straight_press_tells_friction_where_it_is_released(name):
    depth, tells = MOTIONS[name]
    scene = pressed(depth, ANGLES)
    rows = point_drag_rows(scene.voxmap, scene.shell, scene.trajectory).force
    share = distinct_drag(scene, rows)
    assert share > 0.9 if tells else share < 0.05
    why = tt.terms.GlobalCoulomb(scene, "points").not_identifiable()
    assert why == ({} if tells else {"friction_coefficient": ONE_SENSE})


def frictionless(released):
    """Without noise."""
    depth = np.concatenate([DOWN, DOWN[-2::-1]]) if released else DOWN
    return pressed(depth, np.linspace(0.5, 3.0, 8))


@pytest.mark.parametrize("name", ["coulomb_global", "coulomb_drag"])
def test_a_press_that_is_not_released_gives_no_friction(name):
    """The law of force is not the field's, and as much drag as is allowed mends it."""
    scene = frictionless(released=False)
    message = f"{name}: .*friction_coefficient.* not released.*: 0 is used; record the"
    with pytest.warns(TtusWarning, match=message):
        solution = tt.fit(scene, name, acts_at="points")
    assert solution.parameters["friction_coefficient"] == 0.0
    assert solution.not_identified["friction_coefficient"] == ONE_SENSE
    assert "friction_coefficient" not in solution.standard_errors
    line = f"friction_coefficient: not identified ({ONE_SENSE}): 0 is used"
    assert line in solution.identified
    assert estimate_drag(scene, "points").friction_coefficient == 0.0
    search = tt.load_formulation("coulomb_global", scene, acts_at="points").search
    least = [tt.fit(scene, search.build(mu)).objective for mu in (0.0, 0.5, 1.0)]
    assert least[0] > least[1] > least[2]


def test_of_released_presses_without_friction_it_is_found_to_be_none():
    solution = tt.fit(frictionless(released=True), "coulomb_global", acts_at="points")
    error = solution.standard_errors["friction_coefficient"]
    assert abs(solution.parameters["friction_coefficient"]) < 3.0 * error


def test_an_estimate_without_friction_has_the_scale_without_it():
    scene = frictionless(released=False)
    found = estimate_drag(scene, "points")
    p = scene.laplace.solve(scene.b)
    ours = np.concatenate([scene.N @ p, scene.W @ p / scene.torque_length])
    measured = np.concatenate([scene.f, scene.tau / scene.torque_length])
    scale = np.linalg.lstsq(ours[:, None], measured, rcond=None)[0][0]
    assert found.boundary_scale == pytest.approx(scale)
    rest = measured - scale * ours
    assert found.misfit == pytest.approx(np.sqrt(np.mean(rest**2)))


@pytest.mark.parametrize("released", [False, True])
def test_drag_that_was_put_in_is_estimated_only_if_it_is_distinct(released):
    """Least squares finds 0.3 in either; not released, a stiffer field does too."""
    scene = frictionless(released)
    p = scene.laplace.solve(scene.b)
    rows = tt.terms.GlobalCoulomb(scene, "points").rows
    force = scene.N @ p - 0.3 * (rows.force @ p)
    torque = scene.W @ p - 0.3 * (rows.torque @ p)
    found = estimate_drag(with_wrenches(scene, force, torque), "points")
    assert found.friction_coefficient == pytest.approx(0.3 if released else 0.0)
    assert (found.misfit < 1e-9) == released


def test_tuning_takes_no_friction_that_could_be_elastic():
    scene = frictionless(released=False)
    with pytest.warns(TtusWarning, match="coulomb_global: .*: it is left out; record"):
        found = tt.tune(scene, compare=False, acts_at="points")
    assert found.formulation.name == "eq10"
    alone = tt.tune(scene, "coulomb_global", compare=False, acts_at="points")
    assert alone.formulation.name == "coulomb_global"
    names = {one.name for one in alone.hyperparameters}
    assert "friction_coefficient" not in names


def recordings(shared):
    """Surfaces and recordings of hands and robots that press and slide."""
    bundled = Path(example.path("surface.nc"))
    names = ("press_fit", "sweep_fit", "press_test", "sweep_test", "sweep_drag_fit")
    found = [(bundled, bundled.with_name(f"{name}.csv")) for name in names]
    for folder in ("phantom", "phantom_frictionless"):
        for name in names[:4]:
            at = shared / folder
            found.append((at / "surface.nc", at / f"{name}.csv"))
    return found


@pytest.mark.slow
def test_recordings_that_press_release_and_slide_tell_friction(shared):
    shell = tt.PointShell.from_spec(example.PROBE, n_points=200)
    for place, recording in recordings(shared):
        voxmap = tt.Voxmap.from_surface(tt.Surface.load(place), shape=(16, 48, 24))
        poses = tt.read_trajectory(recording)
        scene = tt.Scene.assemble(voxmap, shell, poses, inner=1.0)
        for acts_at in ("points", "contact", "reference"):
            drag = tt.terms.GlobalCoulomb(scene, acts_at)
            assert distinct_drag(scene, drag.rows.force) > 1.7 * LEAST_DISTINCT
