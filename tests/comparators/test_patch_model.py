"""A contact's numbers from its pose and motion, and the frames a law is fitted to."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.comparators.contacts import made
from tests.comparators.recordings import facing, recordings
from tests.comparators.walls import RADIUS, block, pressed, wall
from tests.kit import InputError, torso
from ttus_opt.comparators.base import LEAST_FORCE
from ttus_opt.comparators.patch_law import KelvinVoigt
from ttus_opt.comparators.patch_model import DEPTH_UNIT, FEWEST_FRAMES, LEAST_DEPTH


def test_a_press_on_a_wall_has_a_depth_a_rate_and_a_foot():
    model = KelvinVoigt(surface=wall(), shell=block())
    R, at = pressed(0.004)
    touch = model.geometry.touch(R, at)
    contact = model.contact(touch, at, np.array([-0.03, 0.02, 0.01, 0.0, 0.0, 0.0]))
    assert contact.depth * DEPTH_UNIT == pytest.approx(0.004, rel=0.01)
    assert contact.rate * DEPTH_UNIT == pytest.approx(0.03, rel=0.01)
    np.testing.assert_allclose(contact.place, [RADIUS, 0.0, 0.0], atol=3e-4)
    np.testing.assert_allclose(contact.sliding, [0.0, 0.02, 0.01], atol=2e-3)


def test_the_rate_is_how_fast_the_depth_grows():
    """Turning counts too: the depth a moment later by the finite difference."""
    model, dt = made(KelvinVoigt), 1e-5
    R, at = facing(torso(), 1.1, 0.1, 0.006)
    R = R @ Rotation.from_rotvec([0.05, -0.04, 0.3]).as_matrix()
    touch = model.geometry.touch(R, at)
    twist = np.concatenate([-0.05 * touch.patch.direction, [0.0, 0.0, 0.8]])
    contact = model.contact(touch, at, twist)
    depths = [
        model.geometry.touch(
            Rotation.from_rotvec(s * dt * twist[3:]).as_matrix() @ R,
            at + s * dt * twist[:3],
        ).patch.depth
        for s in (-1.0, 1.0)
    ]
    growth = (depths[1] - depths[0]) / (2.0 * dt)
    # the rate is that of the patch's centre, the depth that of its deepest point
    assert contact.rate * DEPTH_UNIT == pytest.approx(growth, rel=0.1)
    assert contact.sliding @ contact.patch.direction == pytest.approx(0.0, abs=1e-12)
    centre = twist[:3] + np.cross(twist[3:], contact.patch.centre - at)
    back = contact.sliding - contact.rate * DEPTH_UNIT * contact.patch.direction
    np.testing.assert_allclose(back, centre, atol=1e-12)


def test_samples_are_the_frames_that_touch_and_push():
    model = made(KelvinVoigt)
    press, _ = recordings()
    expected = []
    for R, at, force in zip(press.rotation, press.position, press.force, strict=True):
        touch = model.geometry.touch(R, at)
        if len(touch) and touch.patch.depth >= LEAST_DEPTH:
            normal = float(force @ touch.patch.direction)
            if normal > LEAST_FORCE:
                rest = force - normal * touch.patch.direction
                expected.append((touch.patch.depth / DEPTH_UNIT, normal, rest))
    found = model.samples(press, press.force)
    assert len(press) > len(found) == len(expected) > 50
    for sample, (depth, normal, rest) in zip(found, expected, strict=True):
        assert sample.contact.depth == pytest.approx(depth)
        assert sample.normal_force == pytest.approx(normal)
        np.testing.assert_allclose(sample.tangential_force, rest, atol=1e-12)


def test_too_few_frames_that_push_are_told():
    model = made(KelvinVoigt)
    press, _ = recordings()
    samples = model.samples(press, press.force)
    pushing = np.array([f @ f > 1.0 for f in press.force])
    few = np.flatnonzero(pushing)[:FEWEST_FRAMES]
    force = np.zeros_like(press.force)
    force[few] = press.force[few]
    assert len(model.samples(press, force)) == FEWEST_FRAMES < len(samples)
    force[few[0]] = 0.0
    with pytest.raises(InputError, match=r"needs 5 frames .* got 4 of"):
        model.samples(replace(press, force=force), force)
