import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import cdist

import ttus_opt as tt
from tests.kit import (
    TtusWarning,
    ellipsoid,
    presses,
    small_scene,
    three_presses,
    torso,
)
from ttus_opt.fitting.uncertainty.contact_spread import (
    OWN_ERROR,
    contact_spread,
    independent_places,
    pressed_places,
    telling_places,
    told_variance,
    warn_of_one_spot,
)
from ttus_opt.gaussian.matern import matern

SURFACE = torso()
VOXMAP = tt.Voxmap.from_surface(SURFACE, shape=(9, 20, 10), r_inner=0.03)


def scene_of(angle, z, depth):
    """Presses at places of the skin; a seam at θ = 0 must not matter."""
    path = presses(SURFACE, len(angle), np.random.default_rng(0))
    r = SURFACE.radius_at(angle, z) + 0.012 - depth
    position = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    return tt.Scene.assemble(
        VOXMAP, ellipsoid(), replace(path, position=position), inner=1.0
    )


@pytest.mark.parametrize("middle", [1.5, 0.0, 3.1])
def test_deep_presses_in_one_spot_are_told(middle):
    rng = np.random.default_rng(1)
    angle = middle + rng.uniform(-0.01, 0.01, 30)
    scene = scene_of(angle, np.full(30, 0.1), rng.uniform(0.004, 0.012, 30))
    reach = (np.hypot(*scene.trajectory.position[:, :2].T)).max()
    assert contact_spread(scene) < 0.02 * reach + 1e-3
    with pytest.warns(TtusWarning, match=r"within \d\.\d mm of one spot"):
        warn_of_one_spot(scene)


def test_other_places_and_short_tries_are_not():
    rng = np.random.default_rng(1)
    depth = np.full(30, 0.006)
    for angle, z in (
        (1.5 + rng.uniform(-0.2, 0.2, 30), np.full(30, 0.1)),
        (np.full(30, 1.5), 0.1 + rng.uniform(-0.02, 0.02, 30)),
    ):
        warn_of_one_spot(scene_of(angle, z, depth))  # warnings are errors here
    short = scene_of(np.full(10, 1.5), np.full(10, 0.1), depth[:10])
    assert np.isnan(contact_spread(short))
    warn_of_one_spot(short)


def test_frames_in_the_air_do_not_spread_contacts():
    """Ten frames off the skin, all around, beside thirty in one spot."""
    rng = np.random.default_rng(1)
    angle = np.append(np.full(30, 1.5), np.linspace(0.0, 6.0, 10))
    depth = np.append(rng.uniform(0.004, 0.012, 30), np.full(10, -0.02))
    scene = scene_of(angle, np.full(40, 0.1), depth)
    assert not scene.rows.contact_points[30:].any()
    spread = contact_spread(scene)
    assert spread == contact_spread(scene_of(angle[:30], np.full(30, 0.1), depth[:30]))
    assert spread < 1e-3


def test_places_far_apart_count_each_and_frames_of_one_place_once():
    depth = np.full(30, 0.006)
    angle = np.repeat([0.5, 2.5, 4.5], 10)
    three = scene_of(angle, np.full(30, 0.1), depth)
    assert independent_places(three, 0.01) == pytest.approx(3.0, abs=0.05)
    one = scene_of(np.full(30, 0.5), np.full(30, 0.1), depth)
    assert independent_places(one, 0.01) == pytest.approx(1.0, abs=0.05)


def test_places_that_tell_the_deviation_count_by_how_far_they_differ():
    """Against the Fisher information of ln σ by finite differences of a density."""
    angle = np.repeat([1.0, 1.5, 2.0], 10)
    scene = scene_of(angle, np.full(30, 0.1), np.full(30, 0.006))
    at = scene.trajectory.position + scene.trajectory.rotation @ scene.shell.reference
    first = at[::10]
    among = matern(cdist(first, first), 0.1)

    def likely(step, of):
        """Mean of ln N(y; 0, e^(2 step) K + ε) over y of covariance `of`."""
        S = np.exp(2.0 * step) * among + OWN_ERROR * np.eye(3)
        return -0.5 * (np.linalg.slogdet(S)[1] + np.trace(np.linalg.solve(S, of)))

    known, h = among + OWN_ERROR * np.eye(3), 1e-3
    curved = [likely(step, known) for step in (-h, 0.0, h)]
    information = -(curved[0] - 2.0 * curved[1] + curved[2]) / h**2
    found = telling_places(scene, 0.1)
    assert found == pytest.approx(0.5 * information, rel=0.02)
    assert independent_places(scene, 0.1) < found < 3.0


def test_one_place_is_widened_by_bodies_in_general_and_told():
    depth = np.full(30, 0.006)
    mean = tt.terms.UncertainMean(
        np.zeros((1, 0)), np.zeros(30), 1.0, 0.1, (0.4, 0.7), 0.01, (0.03, 0.7)
    )
    one = scene_of(np.full(30, 0.5), np.full(30, 0.1), depth)
    with pytest.warns(
        TtusWarning, match="more than one place, not how stiffness varies"
    ):
        variance = told_variance(one, mean)
    told = 1.0 / 0.7**2, 2.0 * telling_places(one, 0.01)  # of bodies, of the place
    average = np.average(np.log([0.4, 0.1]), weights=told)
    assert variance == pytest.approx(np.exp(average) ** 2 / 0.1**2)
    assert 3.0 < variance < 5.0
    many = scene_of(np.repeat([0.5, 2.5, 4.5], 10), np.full(30, 0.1), depth)
    assert 1.0 < told_variance(many, mean) < 0.7 * variance
    assert told_variance(many, replace(mean, deviation=0.8)) == 1.0


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
