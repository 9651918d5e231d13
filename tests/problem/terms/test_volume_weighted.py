"""Rows by volume: a refined grid leaves the answer."""

import numpy as np
import pytest

from tests.conftest import presses
from ttus_opt.contact.scene import Scene
from ttus_opt.fitting.batch import fit
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.problem.terms import volume_weighted
from ttus_opt.report.metrics import evaluate
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap


def departures(name, refinements, weight):
    """How far measured forces move rendered ones on unseen poses, per grid."""
    surface = Surface.from_radius(np.full((60, 31), 0.09), np.linspace(0.0, 0.2, 31))
    shell = PointShell.ellipsoid(semi_axes=(0.02, 0.015, 0.015), n_points=1000)
    rng = np.random.default_rng(0)
    seen, unseen = (presses(surface, n, rng, depth=0.012) for n in (12, 10))
    found = []
    for n in refinements:  # the skin is a grid layer on each of them
        voxmap = Voxmap.from_surface(
            surface, shape=(6 * n + 1, 24 * n, 10 * n + 1), r_inner=0.03, r_outer=0.12
        )
        scene = Scene.assemble(
            voxmap, shell, seen, inner=3.0, outer=3.0, sampling="trilinear"
        )
        solution = fit(scene, name, force_weight=weight, torque_weight=weight)
        before = PotentialField(
            voxmap, voxmap.grid.unflatten(scene.laplace.solve(scene.b)), "trilinear"
        )
        first, second = (
            evaluate(field, shell, unseen).rendered_force
            for field in (before, solution.field)
        )
        found.append(float(np.linalg.norm(second - first) / np.linalg.norm(first)))
    return found


@pytest.mark.slow
def test_refining_the_grid_leaves_the_volume_weighted_answer():
    fixed = departures("volume_weighted", (1, 2, 3), 1.0)
    assert max(fixed) / min(fixed) < 1.05
    assert abs(fixed[2] - fixed[1]) < 0.7 * abs(fixed[1] - fixed[0])
    moving = departures("eq10_hard_boundary", (1, 2, 3), 1.0)
    assert moving[2] / moving[0] > 1.4  # eq. 10 as printed does depend on the grid


def test_squares_are_an_integral():
    """∇² r²/4 = 1 exactly on the grid: a row's square is ℓ⁴ of its volume over ℓ³."""
    surface = Surface.from_radius(np.full((24, 9), 0.09), np.linspace(0.0, 0.2, 9))
    voxmap = Voxmap.from_surface(surface, shape=(13, 24, 9), r_inner=0.03, r_outer=0.12)
    shell = PointShell.ellipsoid((0.02, 0.015, 0.015), 100)
    poses = presses(surface, 3, np.random.default_rng(0), depth=0.012)
    scene = Scene.assemble(voxmap, shell, poses, inner=1.0, sampling="trilinear")
    grid, length = voxmap.grid, volume_weighted.LENGTH
    p = np.broadcast_to(grid.r[:, None, None] ** 2 / 4.0, grid.shape).reshape(-1)
    found = np.abs(volume_weighted.VolumeWeightedTerm(scene).rows().blocks["p"] @ p)
    i, _, k = np.unravel_index(np.flatnonzero(scene.laplace.free), grid.shape)
    inside = (grid.r[i] < 0.08) & (i > 1) & (k > 0) & (k < 8)
    volume = grid.r[i] * grid.r_step * grid.theta_step * grid.z_step
    expected = length**2 * np.sqrt(volume / length**3)
    assert inside.sum() > 500
    np.testing.assert_allclose(found[inside], expected[inside], rtol=1e-9)
