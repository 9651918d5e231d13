"""The culled, vectorised search against the definition, point by point."""

import functools
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.drags import end_share
from tests.kit import ellipsoid, torso
from ttus_opt.contact.shell_blocks import ShellBlocks
from ttus_opt.haptic.frame import touch
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.probe.cylindrical import cylindrical
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.voxmap import Voxmap

SURFACE = torso()
VOXMAP = Voxmap.from_surface(SURFACE, shape=(24, 40, 21), r_inner=0.04)


def shell():
    return ellipsoid(1500, (0.03, 0.0125, 0.018))


@functools.cache
def data_of(sampling):
    return FrameData.of(VOXMAP, shell(), sampling)


@dataclass(frozen=True)
class Expected:
    """What the definition says of a pose."""

    inside: np.ndarray
    depth: np.ndarray
    in_grid: bool
    beyond: int


def by_definition(R, at):
    grid = VOXMAP.grid
    r, theta, z = cylindrical(shell().points @ R.T + at)
    within = (r <= grid.r_outer) & (z >= grid.z_min) & (z <= grid.z_max)
    depth = (SURFACE.radius_at(theta, z) - r) * end_share(grid, z)
    inside = np.flatnonzero(within & (depth > 0))
    beyond = int((r[inside] < grid.r_inner).sum())
    return Expected(inside, depth, bool(within.any()), beyond)


@pytest.mark.slow
@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_touches_exactly_the_points_inside(sampling, seed):
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


@functools.cache
def tube():
    """A cylinder of 10 cm in a grid to 16 cm: no ceiling is above it."""
    surface = Surface.from_radius(np.full((8, 3), 0.1), np.array([0.0, 0.1, 0.2]))
    return Voxmap.from_surface(surface, shape=(24, 40, 21), r_inner=0.04, r_outer=0.16)


def turned(direction, to):
    """A rotation of one direction to another."""
    return Rotation.align_vectors(to[None], direction[None])[0].as_matrix()


def test_a_point_on_its_blocks_sphere_is_found():
    """Each block's farthest point, 1 µm inside, all others of the block above it."""
    data = FrameData.of(tube(), shell(), "trilinear")
    blocks, points = ShellBlocks.of(shell()), shell().points
    inwards, alone = np.array([-1.0, 0.0, 0.0]), 0
    for b, centre in enumerate(blocks.centre):
        own = blocks.order[blocks.start[b] : blocks.start[b + 1]]
        away = points[own] - centre
        far = int(np.linalg.norm(away, axis=1).argmax())
        R = turned(away[far], inwards)
        at = np.array([0.1 - 1e-6, 0.0, 0.1]) - R @ points[own[far]]
        contact, _, _ = touch(R, at, data)
        r, _, z = cylindrical(points @ R.T + at)
        within = (z >= 0.0) & (z <= 0.2)
        expected = np.flatnonzero(within & (r < 0.1))
        assert own[far] in expected
        assert sorted(blocks.order[data.touched[:contact]]) == expected.tolist()
        alone += len(np.intersect1d(expected, own)) == 1
    assert alone == len(blocks.centre)


@pytest.mark.parametrize(
    ("direction", "edge", "far"),
    [
        ((0.0, 0.0, -1.0), (0.14, 0.0, 0.2), (0.14, 0.0, 0.25)),
        ((0.0, 0.0, 1.0), (0.14, 0.0, 0.0), (0.14, 0.0, -0.05)),
        ((-1.0, 0.0, 0.0), (0.16, 0.0, 0.1), (0.21, 0.0, 0.1)),
        ((0.0, 0.0, -1.0), (0.09, 0.0, 0.2), (0.09, 0.0, 0.25)),
        ((0.0, 0.0, 1.0), (0.09, 0.0, 0.0), (0.09, 0.0, -0.05)),
    ],
)
def test_one_point_in_the_grid_is_enough(direction, edge, far):
    """10 nm within an end or the outer radius, in the air or inside the patient."""
    data = FrameData.of(tube(), shell(), "trilinear")
    along, points = np.array(direction), shell().points
    for rotation in Rotation.random(20, rng=np.random.default_rng(1)):
        R = rotation.as_matrix()
        first = (points @ R.T)[(points @ R.T @ along).argmax()]
        for off, there in ((1e-8, True), (-1e-8, False)):
            contact, in_grid, _ = touch(R, np.array(edge) + off * along - first, data)
            pressed = there and edge[0] < 0.1
            assert (contact, in_grid) == (pressed, there)
        assert not touch(R, np.array(far) - first, data)[1]
