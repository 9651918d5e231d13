"""Order of the field and of rendered force, the surface being no layer of any grid.

The field is p = ln(r₀/r) + a r cos θ + g r² cos 2θ + e I₀(κr) cos κz − c, which is
harmonic, and the patient is where it is positive. Its surface is found by bisection.
"""

import itertools
from functools import cache

import numpy as np
import pytest
from scipy.special import i0

import ttus_opt as tt
from ttus_opt.contact.rows import REFERENCE_AREA, contact_rows
from ttus_opt.laplace.system import LaplaceSystem

R_INNER, R_OUTER, HEIGHT = 0.03, 0.2, 0.2
SHELL = tt.PointShell.ellipsoid((0.03, 0.0125, 0.018), n_points=400)


def potential(r, theta, z):
    """The harmonic field."""
    across = 0.5 * r * np.cos(theta) + 6.0 * r**2 * np.cos(2.0 * theta)
    along = 0.03 * i0(15.0 * r) * np.cos(15.0 * z)
    return np.asarray(np.log(0.1 / r) + across + along - 0.05)


@cache
def patient():
    """Where it is zero, on a grid fine enough to be exact here."""
    theta = 2.0 * np.pi * np.arange(288)[:, None] / 288
    z = np.linspace(0.0, HEIGHT, 145)
    low, high = np.full((288, 145), 0.04), np.full((288, 145), 0.18)
    for _ in range(50):
        middle = 0.5 * (low + high)
        inside = potential(middle, theta, z) > 0.0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return tt.Surface.from_radius(0.5 * (low + high), z)


@cache
def presses():
    """The probe's long axis along z, 0.5 to 15 mm deep at some places."""
    rotations, positions = [], []
    for angle, z, depth in itertools.product(
        (0.3, 1.7, 2.9, 4.4), (0.07, 0.125), (0.0005, 0.004, 0.015)
    ):
        c, s = np.cos(angle), np.sin(angle)
        # columns: the probe's x along z, its y along r
        rotations.append([[0.0, c, -s], [0.0, s, c], [1.0, 0.0, 0.0]])
        r = float(patient().radius_at(angle, z)) + 0.0125 - depth
        positions.append([r * c, r * s, z])
    return np.array(rotations), np.array(positions)


def exact_forces():
    """The sum of the harmonic field over shell points inside, shape (T, 3)."""
    forces = []
    for R, at in zip(*presses(), strict=True):
        x, y, z = (SHELL.points @ R.T + at).T
        p = potential(np.hypot(x, y), np.arctan2(y, x), z)
        weight = SHELL.areas / REFERENCE_AREA * np.maximum(p, 0.0)
        forces.append(weight @ (SHELL.normals @ R.T))
    return np.array(forces)


@cache
def errors(n, boundary):
    """Largest error of the field inside, and of force over the largest force."""
    voxmap = tt.Voxmap.from_surface(
        patient(),
        shape=(n, 2 * n, n + 1),
        r_inner=R_INNER,
        r_outer=R_OUTER,
        boundary=boundary,
    )
    grid, inside = voxmap.grid, voxmap.inside
    exact = potential(grid.r[:, None, None], grid.theta[:, None], grid.z)
    b = grid.flatten(np.where(voxmap.dirichlet & inside, exact, 0.0))
    p = LaplaceSystem.assemble(voxmap).solve(b)
    rows = contact_rows(voxmap, SHELL, *presses(), sampling="trilinear")
    force, true = (rows.N @ p).reshape(-1, 3), exact_forces()
    worst = np.linalg.norm(force - true, axis=1).max()
    return (
        float(np.abs(grid.unflatten(p) - exact)[inside].max()),
        float(worst / np.linalg.norm(true, axis=1).max()),
    )


@pytest.mark.parametrize("what", [0, 1], ids=["field", "force"])
def test_second_order(what):
    coarse, fine = errors(12, "subvoxel")[what], errors(24, "subvoxel")[what]
    assert np.log2(coarse / fine) >= 1.8
    # for comparison, with p = 0 at the centres of the nearest voxels
    assert errors(24, "staircase")[what] > 5.0 * fine


def test_force_on_a_coarse_grid_points_where_it_does_on_a_fine_one():
    """24 × 60 × 30 against the harmonic field: a degree, 2 % of the largest force."""
    voxmap = tt.Voxmap.from_surface(
        patient(), shape=(24, 60, 30), r_inner=R_INNER, r_outer=R_OUTER
    )
    grid = voxmap.grid
    exact = potential(grid.r[:, None, None], grid.theta[:, None], grid.z)
    fixed = voxmap.dirichlet & voxmap.inside
    p = LaplaceSystem.assemble(voxmap).solve(grid.flatten(np.where(fixed, exact, 0.0)))
    rows = contact_rows(voxmap, SHELL, *presses(), sampling="trilinear")
    force, true = (rows.N @ p).reshape(-1, 3), exact_forces()
    size, length = (np.linalg.norm(f, axis=1) for f in (force, true))
    felt = length > 0.05 * length.max()
    cosine = (force * true).sum(axis=1)[felt] / (size * length)[felt]
    assert np.degrees(np.arccos(cosine)).max() < 1.0
    np.testing.assert_allclose(size, length, rtol=0, atol=0.02 * length.max())


@pytest.mark.parametrize("shape", [(10, 24, 12), (17, 30, 11), (24, 60, 30)])
def test_a_straight_press_starts_from_zero_and_never_pulls(shape):
    voxmap = tt.Voxmap.from_surface(patient(), shape=shape, r_inner=R_INNER)
    system = LaplaceSystem.assemble(voxmap)
    p = system.solve(system.right_side(1.0, 1.0))
    assert voxmap.grid.unflatten(p)[voxmap.inside].min() >= -1e-12
    sphere = tt.PointShell.sphere(0.01, n_points=200)
    depths = np.linspace(-0.0005, 0.02, 83)
    for angle, z in ((0.4, 0.06), (2.1, 0.11), (5.0, 0.14)):
        c, s = np.cos(angle), np.sin(angle)
        touch = max_reach(sphere, angle, z)
        away = (touch - depths)[:, None] * np.array([[c, s, 0.0]]) + [0.0, 0.0, z]
        turn = np.tile(np.eye(3), (len(depths), 1, 1))
        rows = contact_rows(voxmap, sphere, turn, away, sampling="trilinear")
        outwards = (rows.N @ p).reshape(-1, 3) @ [c, s, 0.0]
        assert (outwards[depths < -1e-9] == 0.0).all()
        assert outwards[-1] > 0.0
        steps = np.diff(outwards)
        assert (steps >= -1e-12 * outwards[-1]).all()
        assert steps[:4].max() < 5e-3 * outwards[-1]  # from zero without a jump
        assert steps.max() < 0.05 * outwards[-1]


def max_reach(shell, angle, z):
    """The distance from the axis at which a shell's first point touches [m]."""
    low, high = 0.05, 0.2
    surface = patient()
    for _ in range(50):
        middle = 0.5 * (low + high)
        at = np.array([middle * np.cos(angle), middle * np.sin(angle), z])
        x, y, height = (shell.points + at).T
        theta = np.arctan2(y, x) % (2.0 * np.pi)
        touches = (np.hypot(x, y) < surface.radius_at(theta, height)).any()
        low, high = (middle, high) if touches else (low, middle)
    return low
