"""One small torso for the kernels: even and odd counts, and levels that differ."""

import functools
from typing import NamedTuple

import numpy as np
import pytest

from tests.laplace.multigrid.test_solver import explicit, make_grid, torso
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.laplace.multigrid.hierarchy import Hierarchy
from ttus_opt.voxmap.grid import CylindricalGrid


class Torso(NamedTuple):
    """A grid, its free voxels, their levels, and A written down, shape (V, V)."""

    grid: CylindricalGrid
    free: Mask
    hierarchy: Hierarchy
    A: Array


@functools.cache
def made(shape):
    grid = make_grid(shape)
    free = torso(grid)
    A = np.zeros((free.size, free.size))
    at = np.flatnonzero(free)
    A[np.ix_(at, at)] = explicit(grid, free).toarray()
    return Torso(grid, free, Hierarchy.build(grid, free), A)


@pytest.fixture(params=[(10, 12, 8), (9, 11, 7)], ids=["even", "odd"])
def small(request):
    return made(request.param)


def split(layout, values):
    """Voxel values in red-black order, single precision."""
    return layout.split(values.reshape(layout.shape).astype(np.float32))


def noise(free, seed=0):
    """Random values, zero at fixed voxels, shape (V,)."""
    values = np.random.default_rng(seed).normal(size=free.size)
    return np.where(free.reshape(-1), values, 0.0)
