"""The slide is what it says: constant depth, a field of depth alone."""

import numpy as np
import pytest

from tests.kit import some
from ttus_opt.benchmark.parts.ripple import LEAN, OFFSET, RADIUS, cylinder_field, ripple


def test_the_skin_is_the_leaning_cylinder():
    surface = cylinder_field("trilinear", 0.004).voxmap.surface
    points = surface.points().reshape(-1, 3) - [OFFSET, 0.0, 0.0]
    axis = np.array([np.sin(LEAN), 0.0, np.cos(LEAN)])
    away = points - np.outer(points @ axis, axis)
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), RADIUS, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("direction", some(["along", "around"], 1))
def test_interpolation_is_steadier_than_means_and_than_coarser_voxels(direction):
    found = {
        (sampling, voxel): ripple(
            sampling, voxel, direction=direction, n_points=1000, n_poses=60
        )
        for sampling in ("voxel-mean", "trilinear")
        for voxel in (0.002, 0.004)
    }
    fine, coarse = found["trilinear", 0.002], found["trilinear", 0.004]
    # the same force whatever the voxels
    assert fine["mean_force"] == pytest.approx(coarse["mean_force"], rel=0.01)
    assert fine["ripple"] < coarse["ripple"]
    assert coarse["ripple"] < 0.1 * found["voxel-mean", 0.002]["ripple"]
