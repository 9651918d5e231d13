"""The root of wide terms against dense algebra."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from tests.kit import small_scene
from tests.solvers.own_terms import OWN
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.terms.departures import TikhonovTerm
from ttus_opt.solvers.primal.matching import _Stencil, _Waves, matched_root

SCENE = small_scene("trilinear", shape=(7, 12, 9), n_poses=3)
LAPLACE = SCENE.laplace
FREE = np.flatnonzero(LAPLACE.free)


def wide(term, weight):
    rows = term.rows()
    return ProgramTerm(term.name, weight, sp.csr_array(rows.blocks["p"]), rows.target)


def root_of(term):
    ones = np.ones(SCENE.n_voxels)
    return matched_root([term], LAPLACE, ones)


def minus_x(root):
    """L - X on free voxels, from links and screening one by one."""
    grid, total = LAPLACE.grid, LAPLACE.L.toarray()
    index = np.arange(grid.n_voxels).reshape(grid.shape)
    added = np.diag(root.added.screening.ravel())
    for axis, link in enumerate(root.added.links):
        there = np.roll(index, -1, axis)
        for v, w, g in zip(index.ravel(), there.ravel(), link.ravel(), strict=True):
            added[v, v] += g
            added[w, w] += g
            added[v, w] -= g
            added[w, v] -= g
    total -= added / LAPLACE.radii[:, None]
    return np.asarray(total[np.ix_(FREE, FREE)])


@pytest.mark.parametrize("own", [TikhonovTerm, *OWN], ids=lambda term: term.name)
def test_the_square_of_l_minus_x_is_equivalent_to_h(own):
    """The band holds over twelve decades: it is what bounds the steps."""
    L = LAPLACE.L.toarray()[np.ix_(FREE, FREE)]
    for weight in 10.0 ** np.arange(-6, 7, 3):
        term = wide(own(SCENE), weight)
        M = term.matrix.toarray()[:, FREE]
        H = L.T @ L + weight * (M.T @ M)
        root = root_of(term)
        P = minus_x(root)
        ratios = scipy.linalg.eigh(H, P.T @ P, eigvals_only=True)
        assert ratios.max() / ratios.min() < (8.0 if own is TikhonovTerm else 120.0)


def test_a_light_term_adds_next_to_nothing():
    root = root_of(wide(TikhonovTerm(SCENE), 1e-16))
    assert np.abs(root.added.screening).max() < 1e-6
    assert not root.added.links


def test_a_stencil_goes_around_the_turn():
    """Second differences along θ, also across its end; heavy ones are matched."""
    grid = LAPLACE.grid
    index = np.arange(grid.n_voxels).reshape(grid.shape)
    M = sp.csr_array(-2.0 * sp.eye_array(grid.n_voxels))
    for step in (1, -1):
        M = M + sp.eye_array(grid.n_voxels).tocsr()[np.roll(index, step, 1).ravel()]
    term = ProgramTerm("theta", 1e8, sp.csr_array(M), np.zeros(grid.n_voxels))
    stencil = _Stencil.of(term, grid)
    assert stencil.offsets.tolist() == [[0, k, 0] for k in range(-2, 3)]
    np.testing.assert_allclose(6.0 * stencil.values, [1, -4, 6, -4, 1])
    added = root_of(term).added
    free = LAPLACE.free.reshape(grid.shape)
    both = free & np.roll(free, -1, 1)
    link = added.links[1] / LAPLACE.radii.reshape(grid.shape)
    np.testing.assert_allclose(link[both], 1e4, rtol=0.01)


def test_conductances_along_theta_are_those_at_the_geometric_mean_of_radii():
    grid = LAPLACE.grid
    where = np.zeros(grid.shape)
    where[1], where[5] = 3.0, 1.0  # at 48 and 122 mm
    waves = _Waves.of(grid, where.reshape(-1))
    own = np.linalg.lstsq(waves.bend, waves.stiffness)[0]
    radius = (grid.r[1] ** 3 * grid.r[5]) ** 0.25
    steps = grid.r_step / np.array([grid.r_step, radius * grid.theta_step, grid.z_step])
    np.testing.assert_allclose(own, steps**2, rtol=1e-10)
