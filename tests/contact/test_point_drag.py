"""Rows of drag point by point: against frames, and against drag of the whole patch."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ttus_opt as tt
from tests.drags import LAWS, SHELL, VOXMAP, drag_by_points, pushing
from tests.haptic.test_drag import random_pose
from tests.kit import InputError, pressing, small_scene
from ttus_opt.contact.friction import DEADBAND, Sliding, coulomb_rows
from ttus_opt.contact.point_drag import point_drag_rows
from ttus_opt.contact.rows import contact_rows
from ttus_opt.contact.slip import Slip
from ttus_opt.fitting.uncertainty.wrench_uncertainty import rendered, wrench_rows
from ttus_opt.haptic.field_wrench import wrenches_along
from ttus_opt.phantom.recording import add_pose_noise


def moving_by(R, at, twist):
    """Two frames so near to each other that they are one pose with a twist."""
    step = 1e-7
    x, y, z = twist[3:] * step
    turn = np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
    positions = np.stack([at, at + step * twist[:3]])
    return tt.Trajectory(np.array([0.0, step]), positions, np.stack([R, turn @ R]))


@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_rows_are_the_drag_of_every_point(sampling, seed):
    rng = np.random.default_rng(seed)
    field = pushing(sampling, LAWS["coulomb-points"])
    R, at, twist = random_pose(rng, highest=0.0)
    trajectory = moving_by(R, at, twist)
    rows = point_drag_rows(VOXMAP, SHELL, trajectory, sampling=sampling)
    p = -0.3 * field.values.reshape(-1)
    found = np.concatenate([(rows.force @ p)[:3], (rows.torque @ p)[:3]])
    expected = drag_by_points(field, SHELL, R, at, trajectory.twist()[0])
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8)


def test_over_a_flat_patch_it_is_the_drag_of_the_patch():
    """A box of 20 mm slides 0.1 mm deep on a tube of 2 m: its sides are 2 %."""
    tube = tt.Surface.from_radius(np.full((72, 21), 2.0), np.linspace(0.0, 0.2, 21))
    voxmap = tt.Voxmap.from_surface(tube, shape=(24, 1200, 16), r_inner=1.9)
    shell = tt.PointShell.box((0.02, 0.02, 0.02), n_points=2000)
    n = 5
    time = 0.05 * np.arange(n)
    start = np.array([2.0 + 0.01 - 0.0001, 0.0, 0.1])
    position = start + (time - time[2])[:, None] * np.array([0.0, 0.004, 0.003])
    trajectory = tt.Trajectory(time, position, np.tile(np.eye(3), (n, 1, 1)))
    rows = contact_rows(
        voxmap, shell, trajectory.rotation, trajectory.position, sampling="trilinear"
    )
    sliding = Sliding.of(voxmap, shell, trajectory)
    patch = coulomb_rows(sliding, rows)
    points = point_drag_rows(voxmap, shell, trajectory)
    p = np.ones(voxmap.grid.n_voxels)
    drag, expected = (points.force @ p)[6:9], (patch.force @ p)[6:9]
    assert np.linalg.norm(expected) > 0.05
    assert np.linalg.norm(drag - expected) < 0.03 * np.linalg.norm(expected)


@pytest.mark.parametrize("acts_at", ["contact", "reference", "points"])
def test_a_field_with_uncertainty_has_rows_of_the_same_law(acts_at):
    """What `wrench_rows` makes of a field is what `evaluate` judges."""
    scene = small_scene("trilinear")
    parameters = tt.terms.GlobalCoulomb(scene, acts_at, coefficient=0.3).parameters({})
    field = pressing(scene, parameters)
    rows = wrench_rows(field, scene.shell, scene.trajectory)
    judged = wrenches_along(field, scene.shell, scene.trajectory)
    both = np.hstack([judged.force, judged.torque])
    np.testing.assert_allclose(rendered(field, rows), both, atol=1e-10)
    still = replace(field, parameters={})
    bare = wrenches_along(still, scene.shell, scene.trajectory).force
    assert np.abs(both[:, :3] - bare).max() > 0.1


def test_a_trackers_noise_does_not_turn_the_drag():
    """A press of 8 mm with a slow slide, seen with 0.5 mm and 0.5° at 20 Hz."""
    n, field = 240, pushing("trilinear", LAWS["coulomb-points"])
    time, rng = 0.05 * np.arange(n), np.random.default_rng(4)
    R, at, _ = random_pose(rng, highest=-0.004)
    out = np.array([*at[:2], 0.0]) / np.linalg.norm(at[:2])
    away = 0.004 * np.outer(np.cos(2.5 * time), out)
    along = 0.003 * np.outer(np.sin(0.9 * time), np.cross(out, [0.0, 0.0, 1.0]))
    true = tt.Trajectory(time, at + away + along, np.tile(R, (n, 1, 1)))
    noisy = add_pose_noise(true, rng)
    p = field.values.reshape(-1)

    def drag(twist):
        twist[:, :3] += np.cross(twist[:, 3:], noisy.rotation @ SHELL.reference)
        poses, slip = (noisy.rotation, noisy.position), Slip(twist, DEADBAND)
        rows = contact_rows(VOXMAP, SHELL, *poses, sampling="trilinear", slip=slip)
        return (rows.N @ p).reshape(-1, 3)

    found = (point_drag_rows(VOXMAP, SHELL, noisy).force @ p).reshape(-1, 3)
    expected = drag(np.hstack([true.velocity(), true.angular_velocity()]))
    differences = drag(np.hstack([noisy.velocity(), noisy.angular_velocity()]))
    jumps = [
        np.linalg.norm(np.diff(each, axis=0), axis=1).mean()
        for each in (expected, found, differences)
    ]
    assert jumps[2] > 1.7 * jumps[0]  # what differences make of it
    assert jumps[1] < 1.15 * jumps[0]
    off = [np.abs(each - expected).mean() for each in (found, differences)]
    assert off[0] < 0.5 * off[1]


def test_a_sampling_that_is_none_is_refused():
    scene = small_scene("trilinear")
    where = (scene.voxmap, scene.shell, scene.trajectory)
    with pytest.raises(InputError, match="sampling must be one of"):
        point_drag_rows(*where, sampling="nearest")
