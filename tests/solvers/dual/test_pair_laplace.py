"""Two coupled blocks: solves with L and its adjoint against dense algebra."""

import numpy as np
import scipy.sparse as sp

from tests.kit import small_scene
from ttus_opt.laplace.system import BlockSystem
from ttus_opt.solvers.dual.pair_laplace import PairBlock

LAPLACE = small_scene("trilinear", shape=(6, 10, 6), n_poses=4).laplace
FREE, RADII, V = LAPLACE.free, LAPLACE.radii, len(LAPLACE.free)


def made():
    """Some free rows of the second field take from free columns of the first."""
    rng = np.random.default_rng(0)
    free = np.flatnonzero(FREE)
    at = rng.choice(free, (2, 20))
    X = sp.csr_array((rng.normal(size=20), (at[0], at[1])), shape=(V, V))
    own, _ = LAPLACE.coupling
    coupling = sp.csr_array(sp.block_diag([own, own]))
    block = PairBlock(LAPLACE.multigrid, LAPLACE.multigrid, X)
    system = BlockSystem(
        np.tile(FREE, 2), np.tile(RADII, 2),
        (coupling, sp.csr_array(coupling.T)), block,
    )  # fmt: skip
    L = sp.block_diag([LAPLACE.L, LAPLACE.L]).toarray()
    # a row of A is minus the radius times one of L
    L[V:, :V] -= X.toarray() / RADII[:, None]
    return system, L


def test_solves_and_adjoint_solves_are_dense_ones():
    system, L = made()
    g = np.random.default_rng(1).normal(size=2 * V)
    x = system.solve(g)
    np.testing.assert_allclose(L @ x, g, atol=1e-9 * np.abs(L @ np.abs(x)).max())
    w = system.solve_adjoint(g)
    np.testing.assert_allclose(L.T @ w, g, atol=1e-9 * np.abs(L.T @ np.abs(w)).max())


def test_answers_say_what_they_took():
    system, _ = made()
    b = np.where(np.tile(FREE, 2), 1.0, 0.0)
    answer = system.multigrid.solve(b, rtol=1e-8)
    parts = [LAPLACE.multigrid.solve(b[:V], rtol=1e-8)]
    assert answer.iterations > parts[0].iterations
    assert 0.0 < answer.relative_residual <= 1e-8
