from __future__ import annotations

import numpy as np
import pytest

from tests.conftest import ellipsoid, torso
from ttus_opt.contact.rows import REFERENCE_AREA
from ttus_opt.contact.shell_blocks import ShellBlocks
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.voxmap.voxmap import Voxmap

VOXMAP = Voxmap.from_surface(torso(), shape=(12, 24, 11))
SHELL = ellipsoid(333)


@pytest.mark.parametrize("trilinear", [False, True])
def test_points_and_levers_are_the_shells_in_block_order(trilinear: bool) -> None:
    data = FrameData.of(VOXMAP, SHELL, trilinear=trilinear)
    order = ShellBlocks.of(SHELL).order
    np.testing.assert_array_equal(data.points.T, SHELL.points[order])
    weight = SHELL.areas / REFERENCE_AREA if trilinear else np.ones(len(SHELL))
    moments = np.cross(SHELL.points - SHELL.reference, SHELL.normals)
    lever = np.concatenate([SHELL.normals, moments], axis=1) * weight[:, None]
    np.testing.assert_allclose(data.lever, lever[order], rtol=1e-15)


def test_scratch_of_its_own_shares_no_scratch() -> None:
    data = FrameData.of(VOXMAP, SHELL, trilinear=False)
    other = data.with_own_scratch()
    scratch = "place near node touched depth spot voxel share sampled hits"
    for name in scratch.split():
        assert not np.shares_memory(getattr(data, name), getattr(other, name))
    assert other.points is data.points
