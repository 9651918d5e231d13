"""Whole-array numpy agrees with the rows of the fit."""

from dataclasses import replace

import numpy as np
import pytest

from tests.kit import InputError, small_scene
from ttus_opt.benchmark.parts.rendering import frame_times, numpy_frame, time_rendering
from ttus_opt.voxmap.field import PotentialField


@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
def test_a_numpy_frame_is_the_rows_of_the_fit(sampling):
    scene = small_scene(sampling)
    values = np.random.default_rng(1).normal(size=scene.voxmap.grid.shape)
    field = PotentialField(scene.voxmap, values, sampling)
    force = (scene.N @ values.reshape(-1)).reshape(-1, 3)
    torque = (scene.W @ values.reshape(-1)).reshape(-1, 3)
    poses = zip(scene.trajectory.rotation, scene.trajectory.position, strict=True)
    for t, (R, at) in enumerate(poses):
        expected = np.concatenate([force[t], torque[t]])
        np.testing.assert_allclose(
            numpy_frame(field, scene.shell, R, at), expected, atol=1e-11
        )


def test_times_are_of_every_pose_and_pass():
    called: list[float] = []
    poses = [(np.eye(3), np.array([x, 0.0, 0.0])) for x in (1.0, 2.0)]
    found = frame_times(lambda R, at: called.append(at[0]), poses, 3)
    assert called == [1.0] + 3 * [1.0, 2.0]  # once before, to compile
    assert found["median"] < 1.0
    paused = frame_times(lambda R, at: None, poses, 1, pause=0.02)
    assert paused["longest"] < 0.02  # the pause is not timed


def test_needs_contact():
    scene = small_scene("trilinear")
    far = replace(scene.trajectory, position=scene.trajectory.position + 1.0)
    with pytest.raises(InputError, match="no pose touches"):
        time_rendering(replace(scene, trajectory=far), passes=1)
