"""Laplace's equation over a sector of θ with zero flux at its sides."""

from functools import cache

import numpy as np
import pytest

from tests.conftest import torso
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.voxmap import Voxmap

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
    return Surface.from_radius(
        np.repeat(0.5 * (low + high)[:, None], 5, 1), np.linspace(0.0, 0.1, 5)
    )


def error(n):
    """Largest error inside."""
    voxmap = Voxmap.from_surface(
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
    surface = Surface.from_radius(radius, z)
    whole = Voxmap.from_surface(surface, shape=(12, 2 * n, 9), boundary=boundary)
    half = Voxmap.from_surface(
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
    voxmap = Voxmap.from_surface(
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
