"""Whole-array numpy agrees with the rows of the fit."""

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.benchmark.plain_frame import numpy_frame
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
