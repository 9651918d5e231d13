"""Solves through the block on free voxels, symmetric or not, against dense algebra."""

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.laplace.multigrid import MultigridResult
from ttus_opt.laplace.square_system import BlockSolves

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


@dataclass(frozen=True)
class Made(BlockSolves):
    free: Mask
    radii: Array
    coupling: tuple[sp.csr_array, sp.csr_array]
    multigrid: Dense


def made(symmetric):
    """L with identity rows at fixed voxels, and its parts."""
    rng = np.random.default_rng(0)
    radii = rng.uniform(0.5, 2.0, V)
    A = rng.normal(size=(FREE.sum(), FREE.sum()))
    A = A @ A.T + np.eye(len(A)) if symmetric else A + 5.0 * np.eye(len(A))
    L = np.eye(V)
    L[FREE] = rng.normal(size=(FREE.sum(), V)) * ~FREE
    L[np.ix_(FREE, FREE)] = -A / radii[FREE][:, None]
    own = sp.csr_array(np.where(FREE[:, None] & ~FREE, L, 0.0))
    system = Made(FREE, radii, (own, sp.csr_array(own.T)), Dense(A))
    return system, L


@pytest.mark.parametrize("symmetric", [True, False])
def test_solves_are_those_with_L_and_its_adjoint(symmetric):
    system, L = made(symmetric)
    g = np.random.default_rng(1).normal(size=V)
    np.testing.assert_allclose(system.solve(g), np.linalg.solve(L, g), atol=1e-12)
    adjoint = np.linalg.solve(L.T, g)
    np.testing.assert_allclose(system.solve_adjoint(g), adjoint, atol=1e-12)
