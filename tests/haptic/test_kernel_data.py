from dataclasses import replace

import numpy as np
import pytest

from tests.kit import ellipsoid, torso
from ttus_opt.contact.rows import REFERENCE_AREA
from ttus_opt.contact.shell_blocks import BLOCK, ShellBlocks
from ttus_opt.haptic.kernel_data import RUN, FrameData
from ttus_opt.voxmap.voxmap import Voxmap

VOXMAP = Voxmap.from_surface(torso(), shape=(12, 24, 11))
#: Its reference is not the probe's origin
OFFSET = np.array([0.01, -0.02, 0.03])
SHELL = replace(ellipsoid(333), points=ellipsoid(333).points + OFFSET, reference=OFFSET)


@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
def test_points_and_levers_are_the_shells_in_block_order(sampling):
    data = FrameData.of(VOXMAP, SHELL, sampling)
    order = ShellBlocks.of(SHELL).order
    np.testing.assert_array_equal(data.points.T, SHELL.points[order])
    weight = SHELL.areas / REFERENCE_AREA if data.trilinear else np.ones(len(SHELL))
    moments = np.cross(SHELL.points - SHELL.reference, SHELL.normals)
    lever = np.concatenate([SHELL.normals, moments], axis=1) * weight[:, None]
    np.testing.assert_allclose(data.lever, lever[order], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("n_points", [4, RUN * BLOCK * BLOCK + BLOCK])
def test_scratch_has_room_for_a_run_of_blocks_and_for_a_number_a_block(n_points):
    """Compiled code writes there without a check."""
    per_point = ("points", "normals", "areas")
    each = np.resize(np.arange(len(SHELL)), n_points)
    shell = replace(SHELL, **{name: getattr(SHELL, name)[each] for name in per_point})
    data = FrameData.of(VOXMAP, shell, "trilinear")
    least = max(RUN * BLOCK, len(ShellBlocks.of(shell).reach))
    for name in ("place", "node"):
        assert getattr(data, name).shape[1] >= least


def test_scratch_of_its_own_shares_no_scratch():
    data = FrameData.of(VOXMAP, SHELL, "voxel-mean")
    other = data.with_own_scratch()
    scratch = "place near node touched depth spot voxel share sampled hits"
    for name in scratch.split():
        assert not np.shares_memory(getattr(data, name), getattr(other, name))
    assert other.points is data.points
