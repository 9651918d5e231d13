"""Drag in the frames: of a twist, of an estimated one, left out; the force limit."""

import numpy as np
import pytest

from tests.kit import (
    DRAG,
    TWIST,
    InputError,
    TtusWarning,
    deepest_pose,
    pressing,
    refuses,
    small_scene,
)
from ttus_opt.haptic.renderer import Renderer


def test_drag_without_a_motion_is_left_out_and_told_once(scene):
    renderer = Renderer(pressing(scene, DRAG), scene.shell)
    pose = deepest_pose(scene)
    with pytest.warns(TtusWarning, match="friction_coefficient.*give render a twist"):
        first = renderer.render(*pose)
    assert first.drag == "left out"
    assert renderer.render(*pose).drag == "left out"  # a second warning would fail
    bare = Renderer(pressing(scene), scene.shell).render(*pose, TWIST)
    np.testing.assert_array_equal(first.force, bare.force)
    assert bare.drag == "none"
    moved = renderer.render(*pose, TWIST)
    assert moved.drag == "given"
    assert np.linalg.norm(moved.force - first.force) > 0.1
    # a twist is of its own frame only
    np.testing.assert_array_equal(renderer.render(*pose).force, first.force)


def test_drag_that_comes_with_an_update_is_told_too(scene):
    renderer, pose = Renderer(pressing(scene), scene.shell), deepest_pose(scene)
    assert renderer.render(*pose).drag == "none"
    renderer.update(pressing(scene, {"viscous_coefficient": 3.0}))
    with pytest.warns(TtusWarning, match=r"drag \(viscous_coefficient\)"):
        assert renderer.render(*pose).drag == "left out"


def test_drag_that_an_update_takes_away_is_told_until_it_is_gone(scene):
    renderer, pose = Renderer(pressing(scene, DRAG), scene.shell), deepest_pose(scene)
    renderer.render(*pose, TWIST)
    renderer.update(pressing(scene))
    told = [(renderer.render(*pose, TWIST).drag, renderer.blend.progress)]
    while told[-1][1] < 1.0 and len(told) < 10_000:
        told.append((renderer.render(*pose, TWIST).drag, renderer.blend.progress))
    assert len(told) > 10 and told[-1][1] == 1.0
    assert {drag for drag, _ in told} == {"given"}
    assert renderer.render(*pose, TWIST).drag == "none"
    assert repr(renderer).endswith("drag: >")


@pytest.mark.parametrize(
    ("motion", "word"),
    [
        ({"twist": np.zeros(3)}, r"angular velocity .*\(6,\), got \(3,\)"),
        ({"twist": np.full(6, np.nan)}, "twist contains NaN"),
        ({"twist": np.zeros(6), "time": 0.0}, "either twist or time"),
        ({"time": float("nan")}, "time must be finite"),
        ({"time": float("inf")}, "time must be finite and not go back"),
        ({"time": -1.0}, "not go back .*got -1.0 after 0.0"),
    ],
)
def test_unusable_motions(motion, word):
    scene = small_scene("trilinear")
    renderer, pose = Renderer(pressing(scene, DRAG), scene.shell), deepest_pose(scene)
    renderer.render(*pose, time=0.0)
    refuses(InputError, word, renderer.render, *pose, **motion)
    refuses(InputError, word, renderer.render_into, *pose, np.zeros(6), **motion)


PLACES = {
    "contact": {},
    "reference": {
        "drag_at_reference": 1.0,
        "drag_axis_x": 0.0,
        "drag_axis_y": 0.0,
        "drag_axis_z": 1.0,
    },
    "points": {"drag_at_points": 1.0},
}


@pytest.mark.parametrize("place", PLACES)
def test_drag_of_an_estimated_motion(place):
    """Of a steady slide, its twist's; of a hand at rest, none, without a flicker."""
    scene, law = small_scene("trilinear"), {"friction_coefficient": 0.3}
    field = pressing(scene, law | PLACES[place])
    renderer, other = Renderer(field, scene.shell), Renderer(field, scene.shell)
    bare = Renderer(pressing(scene), scene.shell)
    (R, at), velocity = deepest_pose(scene), np.array([0.02, 0.0, -0.03])
    twist = np.concatenate([velocity, np.zeros(3)])
    out = np.zeros(6)
    for k in range(400):
        there = at + (k - 399) * 1e-3 * velocity
        found = renderer.render(R, there, time=5.0 + 1e-3 * k)
    assert found.drag == "estimated"
    expected, contact = other.render(R, there, twist), bare.render(R, there)
    np.testing.assert_allclose(found.force, expected.force, atol=1e-6)
    full = float(np.linalg.norm(expected.force - contact.force))
    assert full > 0.1
    rng, drags = np.random.default_rng(2), []
    for k in range(3000):  # a hand at rest, seen with normal errors of 0.05 mm
        noisy = there + rng.normal(0.0, 5e-5, 3)
        renderer.render_into(R, noisy, out, time=5.4 + 1e-3 * k)
        drags.append(out[:3] - bare.render(R, noisy).force)
    size = np.linalg.norm(drags, axis=1) / full
    change = np.linalg.norm(np.diff(drags, axis=0), axis=1) / full
    assert size[300:].max() < 0.02 and size[1000:].max() < 1e-6
    assert change.max() < 0.1  # while it comes to rest


@pytest.mark.slow
def test_drag_of_an_estimated_motion_takes_energy():
    """Of a hand that turns back again and again, seen with errors, nine tenths."""
    scene = small_scene("trilinear")
    field = pressing(scene, {"friction_coefficient": 0.3, "drag_at_points": 1.0})
    renderer, exact = Renderer(field, scene.shell), Renderer(field, scene.shell)
    bare, (R, at) = Renderer(pressing(scene), scene.shell), deepest_pose(scene)
    time, rng = 1e-3 * np.arange(6000), np.random.default_rng(8)
    waves = [(0.3, 0.004), (0.7, 0.003), (1.1, 0.002)]
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 3))
    path = sum(
        size * np.sin(2.0 * np.pi * rate * time[:, None] + phase[i])
        for i, (rate, size) in enumerate(waves)
    )
    moving = np.gradient(path, 1e-3, axis=0)
    taken, whole, out = 0.0, 0.0, np.zeros(6)
    for t, x, v in zip(time, path, moving, strict=True):
        noisy, twist = at + x + rng.normal(0.0, 5e-5, 3), np.append(v, np.zeros(3))
        renderer.render_into(R, noisy, out, time=t)
        contact = bare.render(R, noisy).force
        taken += float((contact - out[:3]) @ v) * 1e-3
        whole += float((contact - exact.render(R, noisy, twist).force) @ v) * 1e-3
    assert whole > 1e-3
    assert 0.9 * whole < taken < whole
