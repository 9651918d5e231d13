"""The culled, vectorised search against the definition, point by point."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.conftest import ellipsoid, torso
from ttus_opt.contact.shell_blocks import ShellBlocks
from ttus_opt.cylindrical import cylindrical
from ttus_opt.haptic.frame import touch
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.voxmap import Voxmap

SURFACE = torso()
VOXMAP = Voxmap.from_surface(SURFACE, shape=(24, 40, 21), r_inner=0.04)


def shell() -> PointShell:
    return ellipsoid(1500, (0.03, 0.0125, 0.018))


@functools.cache
def data_of(sampling: str) -> FrameData:
    return FrameData.of(VOXMAP, shell(), trilinear=sampling == "trilinear")


@dataclass(frozen=True)
class Expected:
    """What the definition says of a pose."""

    inside: np.ndarray
    depth: np.ndarray
    in_grid: bool
    beyond: int


def by_definition(R: np.ndarray, at: np.ndarray) -> Expected:
    grid = VOXMAP.grid
    r, theta, z = cylindrical(shell().points @ R.T + at)
    within = (r <= grid.r_outer) & (z >= grid.z_min) & (z <= grid.z_max)
    depth = SURFACE.radius_at(theta, z) - r
    inside = np.flatnonzero(within & (depth > 0))
    beyond = int((r[inside] < grid.r_inner).sum())
    return Expected(inside, depth, bool(within.any()), beyond)


@pytest.mark.slow
@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_touches_exactly_the_points_inside(sampling: str, seed: int) -> None:
    """Anywhere: pressed, sunk, across the axis, at the ends, in the air."""
    rng = np.random.default_rng(seed)
    data = data_of(sampling)
    R = Rotation.random(rng=rng).as_matrix()
    at = rng.uniform([-0.16, -0.14, -0.05], [0.16, 0.14, 0.25])
    contact, in_grid, beyond = touch(R, at, data)
    expected = by_definition(R, at)
    touched = ShellBlocks.of(shell()).order[data.touched[:contact]]
    assert sorted(touched) == expected.inside.tolist()
    np.testing.assert_allclose(
        data.depth[:contact], expected.depth[touched], rtol=0, atol=1e-15
    )
    assert in_grid == expected.in_grid
    assert beyond == expected.beyond
    assert not data.hits.any()  # nothing left for the next frame
