"""A fitted field on a small torso, its probe and recordings."""

import functools

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import ellipsoid, small_scene, torso
from ttus_opt.viewer.state import ViewState
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap


@functools.cache
def field(scale=1.0):
    """A pressure of 1 N/cm² per 5 mm of depth, softer at the back."""
    voxmap = tt.Voxmap.from_surface(torso(), shape=(24, 48, 20), r_inner=0.03)
    grid = voxmap.grid
    depth = voxmap.spoke_radius[None] - grid.r[:, None, None]
    softer = 1.0 + 0.5 * np.sin(grid.theta)[None, :, None]
    values = scale * 200.0 * depth * softer
    theta, z = np.arange(12) * 2.0 * np.pi / 12, np.linspace(0.02, 0.18, 5)
    relative = 0.1 + 0.05 * np.cos(theta)[:, None] + z
    return tt.PotentialField(
        voxmap, values, "trilinear", uncertainty=UncertaintyMap(theta, z, relative)
    )


@functools.cache
def probe():
    return ellipsoid()


@functools.cache
def recorded():
    """Presses in a row at one place of the front, with made-up forces."""
    scene = small_scene(n_poses=12)
    return scene.trajectory


@pytest.fixture
def state():
    return ViewState([field()], probe(), recorded())
