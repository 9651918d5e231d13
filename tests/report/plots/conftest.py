"""Fields and evaluations that pictures are drawn of."""

import numpy as np
import pytest

from tests.kit import ellipsoid, presses, torso
from tests.report.plots.drawn import half_seen
from ttus_opt.report.metrics import evaluate
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap


@pytest.fixture(scope="session")
def fields():
    """A field that falls off with the radius, and one with a dent under the skin."""
    voxmap = Voxmap.from_surface(half_seen(), shape=(24, 40, 12))
    grid = voxmap.grid
    r, theta, z = np.meshgrid(grid.r, grid.theta, grid.z, indexing="ij")
    values = 5.0 * (voxmap.surface.radius_at(theta, z) - r) / 0.08
    near = (r - 0.08) ** 2 + (0.08 * (theta - np.pi / 2)) ** 2 + (z - grid.z[4]) ** 2
    dent = 0.4 * np.exp(-near / 0.01**2)
    before = PotentialField(voxmap, values, "trilinear")
    return before, PotentialField(voxmap, values - dent, "trilinear")


@pytest.fixture(scope="session")
def evaluations(fields):
    shell = ellipsoid()
    recorded = presses(torso(), 25, np.random.default_rng(0))
    names = ("Laplace alone", "fitted")
    return {n: evaluate(f, shell, recorded) for n, f in zip(names, fields, strict=True)}
