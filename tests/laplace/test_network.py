"""Networks of conductances, against their matrix itself."""

import numpy as np
import pytest
import scipy.sparse as sp

from tests.kit import small_scene
from ttus_opt.laplace.network import NeighbourRows, by_network
from ttus_opt.problem.terms.departures import difference_rows

SCENE = small_scene("trilinear")
LAPLACE, GRID = SCENE.laplace, SCENE.voxmap.grid
D = difference_rows(GRID)


def conductances_of(slope):
    return NeighbourRows.of(D, GRID).links(slope, GRID.n_voxels)


def test_links_are_the_matrix_off_its_diagonal():
    slope = np.random.default_rng(0).uniform(0.0, 2.0, D.shape[0])
    H = sp.csr_array(D.T @ sp.diags_array(slope) @ D)
    index = np.arange(GRID.n_voxels).reshape(GRID.shape)
    for axis, link in enumerate(conductances_of(slope)):
        after = np.roll(index, -1, axis).reshape(-1)
        entries = -np.asarray(H[np.arange(GRID.n_voxels), after]).reshape(-1)
        np.testing.assert_allclose(link, np.maximum(entries, 0.0), atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("cut", [0.0, 0.05])
def test_a_network_is_inverted_well_cut_or_not(cut):
    """Eigenvalues of P⁻¹H lie between 0.5 and 1.5, where the diagonal's are 1e-3."""
    rng = np.random.default_rng(1)
    slope = 3.0 * (rng.uniform(size=D.shape[0]) >= cut)
    H = sp.csr_array(D.T @ sp.diags_array(slope) @ D + 1e-3 * sp.eye_array(D.shape[1]))
    free = np.flatnonzero(LAPLACE.free)
    diagonal = H.diagonal()
    apply = by_network(LAPLACE, conductances_of(slope), diagonal, ~LAPLACE.free)
    own = H[free][:, free].toarray()
    inverse = np.zeros_like(own)
    for k, v in enumerate(free):
        unit = np.zeros(GRID.n_voxels)
        unit[v] = 1.0
        inverse[:, k] = apply(unit)[free]
    np.testing.assert_allclose(inverse, inverse.T, atol=1e-5 * np.abs(inverse).max())
    sizes = np.linalg.eigvals(inverse @ own).real
    assert sizes.min() > 0.5 and sizes.max() < 1.5


def test_other_rows_are_no_network():
    """Where rows weigh that are no differences of neighbours it is left to others."""
    none = np.zeros((3, GRID.n_voxels))
    assert by_network(LAPLACE, none, np.ones(GRID.n_voxels), ~LAPLACE.free) is None
    two_apart = sp.csr_array(D[::3][:-5] - 2.0 * D[3::3][: D[::3][:-5].shape[0]])
    found = NeighbourRows.of(two_apart, GRID)
    assert len(found.rows) < two_apart.shape[0]
