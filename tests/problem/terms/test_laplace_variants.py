"""Screening and conductivities by direction against cylinders solved by hand."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve
from scipy.special import i0, k0

from tests.conftest import small_scene
from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.terms.anisotropic import AnisotropicTerm
from ttus_opt.problem.terms.screened import ScreenedTerm
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.voxmap import Voxmap

SCENE = small_scene("trilinear")


def tube(n, n_theta=8, n_z=5):
    surface = Surface.from_radius(np.full((8, 3), 0.08), np.array([0.0, 0.1, 0.2]))
    return Voxmap.from_surface(
        surface, shape=(2 * n + 1, n_theta, n_z), r_inner=0.04, r_outer=0.12
    )


def orders(errors):
    return np.log2(np.array(errors[:-1]) / errors[1:])


def anisotropic_error(n):
    """sin(πz/h) times the cylinder functions of π/h·√(k_z/k_r)."""
    voxmap = tube(n, n_z=2 * n + 1)
    system = LaplaceSystem.assemble(voxmap, conductivities=(0.5, 3.0, 2.0))
    grid, kappa = system.grid, np.pi / 0.2 * np.sqrt(2.0 / 0.5)

    def profile(r):
        return i0(kappa * r) * k0(kappa * 0.08) - k0(kappa * r) * i0(kappa * 0.08)

    exact = profile(grid.r)[:, None] * np.sin(np.pi / 0.2 * grid.z)[None]
    exact = np.broadcast_to(exact[:, None, :], grid.shape)
    b = np.where(system.free, 0.0, grid.flatten(exact.copy()))
    p = grid.unflatten(spsolve(system.L.tocsc(), b))
    return float(np.abs(p - exact).max() / np.abs(exact).max())


def test_anisotropic_cylinder_converges_at_second_order():
    assert np.abs(orders([anisotropic_error(n) for n in (4, 8, 16)])[1:] - 2) < 0.15


def test_only_the_ratio_of_conductivities_matters():
    one = AnisotropicTerm(SCENE, conductivities=(1.0, 0.5, 2.0)).rows()
    two = AnisotropicTerm(SCENE, conductivities=(2.0, 1.0, 4.0)).rows()
    first = spsolve(one.blocks["p"].tocsc(), one.target)
    np.testing.assert_allclose(
        spsolve(two.blocks["p"].tocsc(), two.target), first, atol=1e-10
    )


def screened_error(n, kappa):
    """Largest error inside a tube, where p is a sum of I₀(κr) and K₀(κr)."""
    voxmap = tube(n)
    system = LaplaceSystem.assemble(voxmap, screening=kappa)
    r = voxmap.grid.r
    inside = r <= 0.08

    def profile(s):
        return i0(kappa * s) * k0(kappa * 0.08) - k0(kappa * s) * i0(kappa * 0.08)

    exact = (profile(r) / profile(0.04))[inside]
    p = spsolve(system.L.tocsc(), system.right_side(1.0, 1.0))
    p = voxmap.grid.unflatten(p)[inside]
    return float(np.abs(p - exact[:, None, None]).max())


def test_screened_tube_converges_at_second_order():
    errors = [screened_error(n, 60.0) for n in (8, 16, 32)]
    assert np.abs(orders(errors) - 2.0).max() < 0.15
    assert errors[-1] < 1e-3


def test_screening_makes_the_deep_flatter():
    plain = SCENE.laplace.solve(SCENE.b)
    rows = ScreenedTerm(SCENE, screening=30.0).rows()
    screened = spsolve(rows.blocks["p"].tocsc(), rows.target)
    inside = SCENE.voxmap.inside.reshape(-1) & SCENE.laplace.free
    assert (screened[inside] < plain[inside]).all()
    assert (screened[inside] > 0.0).all()


@pytest.mark.parametrize(
    "term",
    [
        AnisotropicTerm(SCENE, conductivities=(1.0, 1.0, 1.0)),
        ScreenedTerm(SCENE, screening=0.0),
    ],
)
def test_nothing_changed_is_l(term):
    rows = term.rows()
    assert abs(rows.blocks["p"] - SCENE.L).max() == 0.0
    np.testing.assert_array_equal(rows.target, SCENE.b)


def test_values_that_are_none():
    words = "screening must not be negative"
    refuses(InputError, words, lambda: ScreenedTerm(SCENE, screening=-1.0).rows())
    for bad in ((1.0, 0.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0)):
        term = AnisotropicTerm(SCENE, conductivities=bad)
        refuses(InputError, "three positive numbers", term.rows)
