"""Blocks hold every point once and bound it; the ceiling bounds the surface."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ttus_opt as tt
from tests.kit import torso
from ttus_opt.contact.shell_blocks import BLOCK, TILES, ShellBlocks, SurfaceCeiling


@pytest.mark.parametrize("n_points", [4, BLOCK, BLOCK + 1, 333, 1000])
def test_every_point_lies_in_one_block_and_its_sphere(n_points):
    shell = tt.PointShell.ellipsoid(semi_axes=(0.03, 0.0125, 0.018), n_points=n_points)
    blocks = ShellBlocks.of(shell)
    assert sorted(blocks.order) == list(range(n_points))
    assert blocks.start[0] == 0
    assert blocks.start[-1] == n_points
    assert np.diff(blocks.start).max() <= BLOCK
    for b, reach in enumerate(blocks.reach):
        mine = shell.points[blocks.order[blocks.start[b] : blocks.start[b + 1]]]
        assert np.linalg.norm(mine - blocks.centre[b], axis=1).max() <= reach


@pytest.mark.slow
def test_blocks_are_compact():
    shell = tt.PointShell.sphere(0.02, n_points=1600)
    blocks = ShellBlocks.of(shell)
    # a round patch of 32 of 1600 points: 4πR²/50 = πρ²
    patch = 2 * 0.02 / np.sqrt(50)
    assert np.median(blocks.reach) < 1.8 * patch


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.sampled_from([0.001, 0.005, 0.02]))
def test_ceiling_bounds_the_surface_as_far_as_a_sphere_reaches(seed, reach):
    rng = np.random.default_rng(seed)
    n_theta, n_z = int(rng.integers(4, 60)), int(rng.integers(2, 30))
    z = np.linspace(-0.05, 0.15, n_z)
    surface = tt.Surface.from_radius(rng.uniform(0.05, 0.1, (n_theta, n_z)), z)
    above = SurfaceCeiling.of(surface, reach)
    assert above.ceiling.shape == TILES
    # a point of a sphere, the sphere's centre at or beyond the floor
    r = rng.uniform(above.tiles.floor, 0.12, 500)
    theta = rng.uniform(0, 2 * np.pi, 500)
    height = rng.uniform(-0.08, 0.18, 500)
    way = rng.normal(size=(500, 3))
    way *= reach * rng.uniform(0, 1, (500, 1)) / np.linalg.norm(way, axis=1)[:, None]
    point = np.stack([r * np.cos(theta), r * np.sin(theta), height], axis=1) + way
    there = surface.radius_at(np.arctan2(point[:, 1], point[:, 0]), point[:, 2])
    j = np.minimum((theta * above.tiles.per_theta).astype(int), TILES[0] - 1)
    k = np.clip((height - above.tiles.z_0) * above.tiles.per_z, 0, TILES[1] - 1)
    assert (there <= above.ceiling[j, k.astype(int)]).all()


def test_ceiling_is_close_on_a_smooth_torso():
    surface = torso(180, 61)
    above = SurfaceCeiling.of(surface, 0.004)
    theta = (np.arange(TILES[0]) + 0.5) / above.tiles.per_theta
    z = above.tiles.z_0 + (np.arange(TILES[1]) + 0.5) / above.tiles.per_z
    slack = above.ceiling - surface.radius_at(theta[:, None], z)
    assert slack.min() > 0
    assert np.median(slack) < 0.004
