"""One V-cycle each way: symmetric, positive definite, close to the inverse."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from tests.kit import small_scene
from tests.solvers.own_terms import AlongZ
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.primal.approximate_system import ApproximateSystem, FixedBlock
from ttus_opt.voxmap.grid import nodes_of

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=3)
LAPLACE, V = SCENE.laplace, SCENE.n_voxels


def written_out(apply):
    return np.array([apply(unit) for unit in np.eye(V)]).T


def band(inverse, H, at):
    """Eigenvalues of P⁻¹H on some voxels; also that P⁻¹ is symmetric."""
    own = inverse[np.ix_(at, at)]
    assert np.abs(own - own.T).max() < 1e-2 * np.abs(own).max()
    exact = np.linalg.inv(H[np.ix_(at, at)])
    return np.asarray(scipy.linalg.eigh((own + own.T) / 2, exact, eigvals_only=True))


def test_the_fixed_block_is_a_schur_complement():
    free = SCENE.laplace.free
    rows = AlongZ(SCENE).rows()
    term = ProgramTerm("wide", 10.0, sp.csr_array(rows.blocks["p"]), rows.target)
    block = FixedBlock.of([term], free, np.ones(len(free)))
    # of all lines along z in which there is a soft voxel
    n_z = SCENE.voxmap.grid.shape[2]
    tied = np.repeat((~free).reshape(-1, n_z).any(axis=1), n_z)
    M = term.matrix.toarray()
    M = M[(M[:, tied] != 0.0).any(axis=1)]
    others = np.flatnonzero(free & (M != 0.0).any(axis=0))
    order = np.concatenate([block.at, others])
    whole = 10.0 * (M.T @ M)[np.ix_(order, order)] + np.eye(len(order))
    k = len(block.at)
    A, B, C = whole[:k, :k], whole[:k, k:], whole[k:, k:]
    schur = A - B @ np.linalg.solve(C, B.T)
    r = np.random.default_rng(0).normal(size=k)
    np.testing.assert_allclose(block.solve(r), np.linalg.solve(schur, r), rtol=1e-8)


def test_light_rows_leave_the_diagonal():
    rows = AlongZ(SCENE).rows()
    term = ProgramTerm("wide", 1e-3, sp.csr_array(rows.blocks["p"]), rows.target)
    free = SCENE.laplace.free
    assert FixedBlock.of([term], free, np.ones(len(free))) is None


@pytest.mark.parametrize(
    ("weight", "soft"),
    [(0.0, False), (1e-2, False), (1e2, False), (1e4, False), (0.0, True)],
)
def test_squares_of_laplace_s_rows_are_solved_to_a_factor(weight, soft):
    """H = LᵀΩ⁻¹L + w I, Ω four times as large in the outer layers.

    Of boundary values that may move only L's own rows are matched.
    """
    layer, _, _ = nodes_of(np.arange(V), SCENE.voxmap.grid.shape)
    compliance, L = np.where(layer < 3, 1.0, 4.0), LAPLACE.L.toarray()
    H = L.T @ (L / compliance[:, None]) + weight * np.eye(V)
    moving = LAPLACE.free | soft
    one = sp.csr_array(sp.eye_array(V, format="csr"))
    wide = [ProgramTerm("ridge", weight, one, np.zeros(V))] if weight else []
    own = np.where(moving, compliance, 0.0)
    exact = DualSystem(LAPLACE, own, sp.csr_array((0, V)), np.zeros(0))
    apply = ApproximateSystem.matched(exact, wide).prior
    ratios = band(written_out(apply), H, np.flatnonzero(moving))
    assert 0.7 < ratios.min() <= ratios.max() < 1.6
