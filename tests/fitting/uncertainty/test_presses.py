"""Presses, and those of one place."""

import functools
from dataclasses import replace

import numpy as np

import ttus_opt as tt
from tests.fitting.uncertainty.test_contact_spread import scene_of
from tests.kit import ellipsoid, presses, small_scene, three_presses, torso
from ttus_opt.fitting.uncertainty.presses import pressed_places


def test_recordings_and_air_part_presses():
    scene = three_presses()
    inside = scene.rows.contact_points > 0
    assert not inside[4::5].any()
    numbers = scene.presses
    assert len(np.unique(numbers[inside])) == 3
    two = tt.Trajectory.concatenate(
        [presses(torso(), 5, np.random.default_rng(k)) for k in (1, 2)]
    )
    voxmap = small_scene("trilinear").voxmap
    joined = tt.Scene.assemble(voxmap, ellipsoid(), two, sampling="trilinear")
    assert len(np.unique(joined.presses)) == 2


@functools.cache
def pressed():
    """Two presses at one place, two beside it, and a line over them."""
    angle = np.concatenate(
        [np.repeat([1.5, 1.9, 1.506, 1.2], 4), [1.2], np.linspace(1.2, 1.9, 9)]
    )
    depth = np.array([*4 * [-0.02, 0.004, 0.008, 0.006], -0.02, *9 * [0.006]])
    return scene_of(angle, np.full(len(angle), 0.1), depth)


def test_presses_at_one_place_are_left_out_together():
    """By a third of a degree; not those a probe's size beside, nor a line."""
    touching = pressed().rows.contact_points > 0
    place = pressed_places(pressed())[touching]
    press = pressed().presses[touching]
    first, second, again, last, line = (place[press == n] for n in np.unique(press))
    assert set(first) == set(again)
    assert len({first[0], second[0], last[0], line[0]}) == 4
    assert len(set(line)) == 1


def test_few_presses_are_divided_by_the_probe_s_size():
    few = pressed().trajectory.select(np.arange(12, 26))
    scene = replace(pressed(), trajectory=few)
    rows = replace(scene.rows, contact_points=pressed().rows.contact_points[12:26])
    scene = replace(scene, rows=rows)
    touching = scene.rows.contact_points > 0
    place = pressed_places(scene)[touching]
    assert len(np.unique(scene.presses[touching])) == 2
    assert len(np.unique(place)) > 3
    at = few.position[touching]
    for number in np.unique(place):
        away = np.linalg.norm(at[place == number] - at[place == number][0], axis=1)
        assert away.max() <= scene.shell.rms_radius


def test_presses_after_a_line_are_places_too():
    """The same frames, the line first."""
    n = len(pressed().trajectory)
    order = np.roll(np.arange(n), 10)
    own = pressed().trajectory
    moved = replace(own, position=own.position[order], rotation=own.rotation[order])
    scene = replace(pressed(), trajectory=moved)
    count = pressed().rows.contact_points[order]
    scene = replace(scene, rows=replace(scene.rows, contact_points=count))
    touching = count > 0
    place, press = pressed_places(scene)[touching], scene.presses[touching]
    line, first, second, again, last = (place[press == k][0] for k in np.unique(press))
    assert first == again
    assert len({line, first, second, last}) == 4
