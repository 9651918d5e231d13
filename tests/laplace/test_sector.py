"""Laplace's equation over a sector of θ with zero flux at its sides.

Over a sector of θ nothing reaches through its sides or into its wall.
"""

from functools import cache

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import TtusWarning, ellipsoid, presses, torso
from ttus_opt.gaussian.matern import SeparableCovariance
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.terms.departures import difference_rows

#: 100°, and the wave that has no flux at its sides
SECTOR = (np.radians(40.0), np.radians(140.0))
WAVE = np.pi / (SECTOR[1] - SECTOR[0])


def harmonic(r, theta):
    """ln(r₀/r) and a harmonic of the sector's own wave."""
    return np.asarray(
        np.log(0.1 / r) + 0.1 * (r / 0.1) ** WAVE * np.cos(WAVE * (theta - SECTOR[0]))
    )


@cache
def patient():
    """Where it is zero within the sector; beside it, whatever."""
    theta = 2.0 * np.pi * np.arange(360) / 360
    low, high = np.full(360, 0.05), np.full(360, 0.16)
    held = np.clip(theta, *SECTOR)
    for _ in range(50):
        middle = 0.5 * (low + high)
        inside = harmonic(middle, held) > 0.0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return tt.Surface.from_radius(
        np.repeat(0.5 * (low + high)[:, None], 5, 1), np.linspace(0.0, 0.1, 5)
    )


def error(n):
    """Largest error inside."""
    voxmap = tt.Voxmap.from_surface(
        patient(), shape=(n, n + 1, 6), r_inner=0.03, r_outer=0.2, sector=SECTOR
    )
    grid = voxmap.grid
    exact = np.broadcast_to(
        harmonic(grid.r[:, None], grid.theta)[..., None], grid.shape
    )
    fixed = voxmap.dirichlet & voxmap.inside
    p = LaplaceSystem.assemble(voxmap).solve(grid.flatten(np.where(fixed, exact, 0.0)))
    return float(np.abs(grid.unflatten(p) - exact)[voxmap.inside].max())


def test_second_order():
    coarse, fine = error(16), error(32)
    assert np.log2(coarse / fine) >= 1.8


@pytest.mark.parametrize("boundary", ["subvoxel", "staircase"])
@pytest.mark.parametrize("n", [11, 12], ids=["even", "odd"])
def test_a_symmetric_body_is_its_half(boundary, n):
    """To the mirror images of a body whose plane of symmetry holds the sides."""
    step = np.pi / n
    theta = 0.5 * step * (1.0 + np.arange(4 * n))[:, None]
    z = np.linspace(0.0, 0.2, 7)
    radius = 0.1 + 0.01 * np.cos(theta) + 0.015 * np.cos(2.0 * theta) + 0.05 * z
    surface = tt.Surface.from_radius(radius, z)
    whole = tt.Voxmap.from_surface(surface, shape=(12, 2 * n, 9), boundary=boundary)
    half = tt.Voxmap.from_surface(
        surface,
        shape=(12, n + 1, 9),
        r_outer=whole.grid.r_outer,
        boundary=boundary,
        sector=(-0.5 * step, np.pi - 0.5 * step),
    )
    of_whole, of_half = LaplaceSystem.assemble(whole), LaplaceSystem.assemble(half)
    p = whole.grid.unflatten(of_whole.solve(of_whole.right_side(1.0, 2.0)))
    q = half.grid.unflatten(of_half.solve(of_half.right_side(1.0, 2.0)))
    np.testing.assert_allclose(q[:, :n], p[:, :n], rtol=0, atol=1e-10)
    assert (q[:, n] == 0.0).all()


def test_solves_are_those_of_the_matrix():
    """And of variants of the operator, whose grid is another one."""
    voxmap = tt.Voxmap.from_surface(
        torso(), shape=(10, 14, 8), sector=(np.radians(300.0), np.radians(420.0))
    )
    plain, rng = LaplaceSystem.assemble(voxmap), np.random.default_rng(0)
    other = plain.variant(conductivities=(1.0, 3.0, 0.5), screening=20.0)
    for system in (plain, other):
        g = rng.normal(size=system.L.shape[0])
        p = system.solve(g, rtol=1e-12)
        q = system.solve_adjoint(g, rtol=1e-12)
        np.testing.assert_allclose(system.L @ p, g, rtol=0, atol=1e-9)
        np.testing.assert_allclose(system.L.T @ q, g, rtol=0, atol=1e-9)
        wall = voxmap.grid.unflatten(np.arange(len(g)))[:, -1].reshape(-1)
        others = np.setdiff1d(np.arange(len(g)), wall)
        assert abs(system.L[others][:, wall]).max() == 0.0


@pytest.fixture(scope="module")
def scene():
    """Presses in a sector of 150° around the front, two of them across its sides."""
    sector = (np.radians(15.0), np.radians(165.0))
    voxmap = tt.Voxmap.from_surface(torso(), shape=(9, 12, 8), sector=sector)
    poses = presses(torso(), 12, np.random.default_rng(0))
    with pytest.warns(TtusWarning, match="2 of 12 poses touch .* beyond the grid's"):
        return tt.Scene.assemble(
            voxmap, ellipsoid(), poses, inner=2.0, outer=1.5, sampling="trilinear"
        )


def test_the_fit_is_that_of_dense_algebra(scene):
    solution = tt.fit(scene, "eq10", force_weight=0.5, torque_weight=0.2)
    scale = np.sqrt(0.5), np.sqrt(0.2) / scene.torque_length
    parts = (scene.L, scale[0] * scene.N, scale[1] * scene.W)
    rows = np.concatenate([np.asarray(part.toarray()) for part in parts])
    target = np.concatenate([scene.b, scale[0] * scene.f, scale[1] * scene.tau])
    p = scene.voxmap.grid.unflatten(np.linalg.solve(rows.T @ rows, rows.T @ target))
    np.testing.assert_allclose(solution.field.values, p, rtol=0, atol=1e-6)
    assert np.abs(p[:, -1]).max() < 1e-9


def test_a_press_on_the_front_is_fitted_as_on_the_full_turn():
    """Presses within 40° of the middle of a sector of 165° do not feel its sides."""
    poses = presses(torso(), 30, np.random.default_rng(1))
    angle = np.arctan2(poses.position[:, 1], poses.position[:, 0])
    front = poses.select(np.abs(angle - 0.5 * np.pi) < np.radians(40.0))
    told, unseen = front.select(slice(0, None, 2)), front.select(slice(1, None, 2))
    forces = []
    for n, sector in ((24, None), (12, (np.radians(7.5), np.radians(172.5)))):
        voxmap = tt.Voxmap.from_surface(
            torso(), shape=(10, n, 9), r_outer=0.15, sector=sector
        )
        scene = tt.Scene.assemble(voxmap, ellipsoid(), told, inner=2.0, outer=1.5)
        field = tt.fit(scene, "eq10", force_weight=1.0, torque_weight=1.0).field
        forces.append(tt.evaluate(field, ellipsoid(), unseen).rendered_force)
    whole, part = forces
    np.testing.assert_allclose(part, whole, rtol=0, atol=0.01 * np.abs(whole).max())
    assert np.abs(part - whole).max() > 0.0


def test_differences_stay_within_the_sector(scene):
    grid = scene.voxmap.grid
    D = difference_rows(grid)
    angle = np.broadcast_to(np.arange(12.0)[:, None], grid.shape).copy()
    angle[:, -1] = 0.0
    slopes = (D @ angle.reshape(-1)).reshape(*grid.shape, 3)
    arc = grid.r_step / (grid.r * grid.theta_step)
    expected = np.broadcast_to(arc[:, None, None], (9, 10, 8))
    np.testing.assert_allclose(slopes[:, :10, :, 1], expected)
    assert (slopes[:, 10:, :, 1] == 0.0).all()
    assert (slopes[..., [0, 2]] == 0.0).all()


def test_a_free_surface_keeps_the_wall(scene):
    rows = tt.terms.LaplaceFreeSurfaceTerm(scene, 1.0, skin=0.0).rows().blocks["p"]
    wall = np.arange(scene.n_voxels).reshape(scene.voxmap.grid.shape)[:, -1].ravel()
    assert (rows[wall] != scene.L[wall]).nnz == 0
    dropped = np.flatnonzero(np.diff(rows.indptr) == 0)
    assert len(dropped)
    assert not np.isin(dropped, wall).any()


def test_a_depth_map_is_correlated_within_the_sector_alone(scene):
    """The first spokes know of the next ones as inside, of the last ones nothing."""
    n_z = scene.voxmap.grid.shape[2]
    prior = SeparableCovariance.over(
        scene.voxmap, np.ones(scene.n_voxels), surface_length=0.05, depth_length=0.015
    )
    first = prior.surface.covariance(np.array([n_z // 2]))[:, 0].reshape(12, n_z)
    assert (np.abs(first[-1]) < 1e-12).all()
    around = first[:, n_z // 2]
    assert (np.diff(around[:-1]) < 0.0).all()
    assert around[10] < 0.01 * around[0]
