"""Conductivities by direction against a cylinder solved by hand."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve
from scipy.special import i0, k0

from tests.conftest import small_scene
from tests.problem.terms.tubes import orders, tube
from ttus_opt.core.errors import InputError
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.terms.anisotropic import AnisotropicTerm

SCENE = small_scene("trilinear")


def anisotropic_error(n: int) -> float:
    """sin(πz/h) times the cylinder functions of π/h·√(k_z/k_r)."""
    voxmap = tube(n, n_z=2 * n + 1)
    system = LaplaceSystem.assemble(voxmap, conductivities=(0.5, 3.0, 2.0))
    grid, kappa = system.grid, np.pi / 0.2 * np.sqrt(2.0 / 0.5)

    def profile(r: np.ndarray) -> np.ndarray:
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


def test_with_equal_conductivities_it_is_l():
    rows = AnisotropicTerm(SCENE, conductivities=(1.0, 1.0, 1.0)).rows()
    assert abs(rows.blocks["p"] - SCENE.L).max() == 0.0
    np.testing.assert_array_equal(rows.target, SCENE.b)


@pytest.mark.parametrize("bad", [(1.0, 0.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0)])
def test_conductivities_that_are_none(bad):
    with pytest.raises(InputError, match="three positive numbers"):
        AnisotropicTerm(SCENE, conductivities=bad).rows()
