"""L and b against analytic fields, a plain reference assembly, and the maximum
principle."""

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve
from scipy.special import i0, k0

from tests.kit import InputError, refuses, torso
from ttus_opt.core.arrays import Array
from ttus_opt.laplace.multigrid import MultigridResult
from ttus_opt.laplace.system import BlockSystem, LaplaceSystem
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.voxmap import INSIDE, SURFACE, Voxmap


def tube(shape, r_inner, radius, r_outer):
    surface = Surface.from_radius(np.full((8, 3), radius), np.array([0.0, 0.1, 0.2]))
    voxmap = Voxmap.from_surface(surface, shape=shape, r_inner=r_inner, r_outer=r_outer)
    return LaplaceSystem.assemble(voxmap)


def annulus_error(n):
    """Largest error of p = ln(R/r)/ln(R/r_in) inside, R on a layer."""
    system = tube((2 * n + 1, 8, 5), 0.04, 0.08, 0.12)
    p = system.grid.unflatten(system.solve(system.right_side(1.0, 1.0)))
    r = system.grid.r
    exact = np.where(
        r < 0.08, np.log(0.08 / r) / np.log(2.0), -np.log(r / 0.08) / np.log(1.5)
    )
    return float(np.abs(p - exact[:, None, None]).max())


def cylinder_error(n):
    """Error of the radially symmetric finite-cylinder solution sin(πz/h)·(I₀, K₀)."""
    system = tube((2 * n + 1, 8, 2 * n + 1), 0.04, 0.08, 0.12)
    grid, kappa = system.grid, np.pi / 0.2

    def profile(r):
        return i0(kappa * r) * k0(kappa * 0.08) - k0(kappa * r) * i0(kappa * 0.08)

    exact = np.broadcast_to(
        (profile(grid.r)[:, None] * np.sin(kappa * grid.z)[None])[:, None, :],
        grid.shape,
    )
    b = np.where(system.free, 0.0, grid.flatten(exact.copy()))
    p = grid.unflatten(system.solve(b))
    return float(np.abs(p - exact).max() / np.abs(exact).max())


def angular_error(n):
    """Error of cos(2θ)·(r² - R⁴/r²), which exercises the θ stencil."""
    system = tube((2 * n + 1, 4 * n, 5), 0.04, 0.08, 0.12)
    grid = system.grid
    radial = grid.r**2 - 0.08**4 / grid.r**2
    exact = radial[:, None, None] * np.cos(2 * grid.theta)[None, :, None]
    exact = np.broadcast_to(exact, grid.shape)
    p = system.solve(np.where(system.free, 0.0, grid.flatten(exact.copy())))
    return float(np.abs(grid.unflatten(p) - exact).max() / np.abs(exact).max())


@pytest.mark.parametrize("error", [annulus_error, cylinder_error, angular_error])
def test_the_order_is_the_second(error):
    errors = [error(n) for n in (4, 8, 16, 32)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.abs(orders[1:] - 2.0).max() < 0.1
    assert errors[-1] < 1e-4 or error is not annulus_error


@pytest.fixture(scope="module")
def system():
    return LaplaceSystem.assemble(Voxmap.from_surface(torso(), shape=(14, 24, 11)))


def test_rows_are_dimensionless(system):
    """The same torso forty times as large has the same L: λ is a pure number."""
    surface = torso()
    scaled = Surface.from_radius(surface.radius * 40, surface.z * 40)
    voxmap = Voxmap.from_surface(
        scaled, shape=(14, 24, 11), r_inner=1.2, r_outer=system.grid.r_outer * 40
    )
    assert abs(LaplaceSystem.assemble(voxmap).L - system.L).max() < 1e-12


def test_sign_and_maximum_principle(system):
    p = system.grid.unflatten(system.solve(system.right_side(3.0, 2.0)))
    region = system.voxmap.region
    assert (p[region == INSIDE] > 0).all()
    assert np.abs(p[region == SURFACE]).max() == 0.0
    assert (p[region < 0] < 0).all()
    assert p.max() <= 3.0 + 1e-12
    assert p.min() >= -2.0 - 1e-12
    interior = system.grid.unflatten(system.free)
    assert p[interior].max() < 3.0
    assert p[interior].min() > -2.0


@pytest.fixture(scope="module")
def tiny():
    """Small enough for dense decompositions."""
    return Voxmap.from_surface(torso(), shape=(9, 12, 7))


def test_full_column_rank_and_a_free_block_that_is_symmetric_positive_definite(tiny):
    system = LaplaceSystem.assemble(tiny)
    smallest = np.linalg.svd(system.L.toarray(), compute_uv=False)[-1]
    assert smallest > 1e-4
    A = (sp.diags_array(-system.radii) @ system.L).toarray()
    A = A[np.ix_(system.free, system.free)]
    np.testing.assert_allclose(A, A.T, rtol=0, atol=1e-15)
    assert np.linalg.eigvalsh(A)[0] > 0


def test_ends_solve_the_polar_problem():
    """On a tube the end slices are the annulus solution, independent of z."""
    system = tube((65, 8, 5), 0.04, 0.08, 0.12)
    b = system.grid.unflatten(system.right_side(1.0, 0.0))
    inside = system.grid.r < 0.08
    exact = np.log(0.08 / system.grid.r) / np.log(2.0) * inside
    for k in (0, -1):
        np.testing.assert_allclose(b[:, :, k], exact[:, None] * np.ones(8), atol=1e-4)


def test_a_surface_that_is_the_outer_layer_knows_no_outside():
    """The annulus between the inner layer and R = r_outer, ends and middle."""
    system = tube((65, 8, 5), 0.04, 0.12, 0.12)
    assert not system.outer_part.any()
    p = system.grid.unflatten(system.solve(system.right_side(1.0, 1.0)))
    exact = np.log(0.12 / system.grid.r) / np.log(3.0)
    np.testing.assert_allclose(p, exact[:, None, None] + 0 * p, atol=2e-4)


def test_right_side_is_linear_and_checked(system):
    b = system.right_side(2.0, 3.0)
    np.testing.assert_allclose(b, 2 * system.inner_part + 3 * system.outer_part)
    refuses(InputError, "finite", system.right_side, float("inf"), 1.0)


def test_skin_on_the_outer_layer_is_zero_at_the_ends_too():
    system = tube((9, 8, 5), 0.04, 0.118, 0.12)
    assert (system.voxmap.region[-1] == SURFACE).all()
    b = system.grid.unflatten(system.right_side(1.0, 2.0))
    assert not b[-1].any()
    assert (b[0] == 1.0).all()


def test_screening_takes_from_the_diagonal(tiny):
    """κ² Δr² off the diagonal of free rows: (κ Δr)² = 0.09 by hand."""
    plain, kappa = LaplaceSystem.assemble(tiny), 0.3 / tiny.grid.r_step
    change = (LaplaceSystem.assemble(tiny, screening=kappa).L - plain.L).toarray()
    np.testing.assert_allclose(change, np.diag(-0.09 * plain.free), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "given",
    [
        {"conductivities": (1.0, 0.0, 1.0)},
        {"conductivities": (1.0, np.inf, 1.0)},
        {"conductivities": (1.0, 1.0)},
        {"screening": -1e-9},
        {"screening": np.nan},
    ],
)
def test_variants_are_checked(tiny, given):
    (name,) = given
    refuses(InputError, name, LaplaceSystem.assemble, tiny, **given)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"screening": 1.0},
        {"screening": 300.0},
        {"conductivities": (2.0, 1.0, 1.0)},
        {"conductivities": (2.0, 2.0, 1.0)},
        {"conductivities": (1.0, 50.0, 0.02), "screening": 20.0},
    ],
)
def test_solves_of_a_variant_equal_a_factorisation(tiny, given):
    system = LaplaceSystem.assemble(tiny, **given)
    g = np.random.default_rng(1).normal(size=len(system.free))
    L = sp.csc_array(system.L)
    np.testing.assert_allclose(system.solve(g), spsolve(L, g), rtol=1e-9, atol=1e-9)
    expected = spsolve(sp.csc_array(L.T), g)
    np.testing.assert_allclose(system.solve_adjoint(g), expected, rtol=1e-9, atol=1e-9)


def test_a_variant_is_assembled_once(tiny):
    system = LaplaceSystem.assemble(tiny)
    one = system.variant(conductivities=(1.0, 2.0, 3.0))
    assert one is system.variant(conductivities=(1.0, 2.0, 3.0))
    assert one is not system.variant(conductivities=(1.0, 2.0, 3.0), screening=1.0)


def test_couplings_are_the_block_of_free_rows_and_fixed_columns():
    system = LaplaceSystem.assemble(Voxmap.from_surface(torso(), shape=(9, 20, 10)))
    L, free = system.L.toarray(), system.free
    expected = np.where(free[:, None] & ~free, L, 0.0)
    there, back = system.coupling
    np.testing.assert_array_equal(there.toarray(), expected)
    np.testing.assert_array_equal(back.toarray(), expected.T)
    for matrix in (system.L, there, back):  # half the memory of 64 bits
        assert matrix.indices.dtype == matrix.indptr.dtype == np.int32


V = 9
FREE = np.array([0, 1, 1, 0, 1, 1, 1, 0, 1], dtype=bool)


@dataclass(frozen=True)
class Dense:
    """The block A with zero at fixed voxels."""

    A: Array

    def preconditioner(self, near):
        raise NotImplementedError

    def solve(self, rhs, *, rtol):
        x = np.zeros(V)
        x[FREE] = np.linalg.solve(self.A, rhs[FREE])
        return MultigridResult(x, 1, rtol)

    def solve_adjoint(self, rhs, *, rtol):
        return Dense(self.A.T).solve(rhs, rtol=rtol)


def square(symmetric):
    """L with identity rows at fixed voxels, and its parts."""
    rng = np.random.default_rng(0)
    radii = rng.uniform(0.5, 2.0, V)
    A = rng.normal(size=(FREE.sum(), FREE.sum()))
    A = A @ A.T + np.eye(len(A)) if symmetric else A + 5.0 * np.eye(len(A))
    L = np.eye(V)
    L[FREE] = rng.normal(size=(FREE.sum(), V)) * ~FREE
    L[np.ix_(FREE, FREE)] = -A / radii[FREE][:, None]
    own = sp.csr_array(np.where(FREE[:, None] & ~FREE, L, 0.0))
    system = BlockSystem(FREE, radii, (own, sp.csr_array(own.T)), Dense(A))
    return system, L


@pytest.mark.parametrize("symmetric", [True, False])
def test_solves_are_those_with_L_and_its_adjoint(symmetric):
    system, L = square(symmetric)
    g = np.random.default_rng(1).normal(size=V)
    np.testing.assert_allclose(system.solve(g), np.linalg.solve(L, g), atol=1e-12)
    adjoint = np.linalg.solve(L.T, g)
    np.testing.assert_allclose(system.solve_adjoint(g), adjoint, atol=1e-12)
