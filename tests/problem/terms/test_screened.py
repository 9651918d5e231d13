"""Screening against Bessel functions."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve
from scipy.special import i0, k0

from tests.conftest import small_scene
from tests.problem.terms.tubes import orders, tube
from ttus_opt.core.errors import InputError
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.terms.screened import ScreenedTerm

SCENE = small_scene("trilinear")


def screened_error(n: int, kappa: float) -> float:
    """Largest error inside a tube, where p is a sum of I₀(κr) and K₀(κr)."""
    voxmap = tube(n)
    system = LaplaceSystem.assemble(voxmap, screening=kappa)
    r = voxmap.grid.r
    inside = r <= 0.08

    def profile(s: np.ndarray | float) -> np.ndarray:
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


def test_without_screening_it_is_l():
    rows = ScreenedTerm(SCENE, screening=0.0).rows()
    assert abs(rows.blocks["p"] - SCENE.L).max() == 0.0
    np.testing.assert_array_equal(rows.target, SCENE.b)


def test_screening_that_is_none():
    with pytest.raises(InputError, match="screening must not be negative"):
        ScreenedTerm(SCENE, screening=-1.0).rows()
