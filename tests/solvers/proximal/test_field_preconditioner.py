"""Preconditioners of a field, written out, against the matrices they stand for."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from tests.conftest import small_scene
from ttus_opt.core.arrays import Array
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.terms.total_variation import difference_rows
from ttus_opt.solvers.conjugate_gradients import Map
from ttus_opt.solvers.proximal.field_preconditioner import (
    LEFT,
    by_differences,
    by_laplace,
    with_few_rows,
)
from ttus_opt.voxmap.grid import nodes_of

SCENE = small_scene("trilinear", shape=(6, 8, 6), n_poses=3)
LAPLACE, V = SCENE.laplace, SCENE.n_voxels
NONE_FIXED = np.zeros(V, dtype=bool)


def written_out(apply: Map) -> Array:
    return np.array([apply(unit) for unit in np.eye(V)]).T


def band(inverse: Array, H: Array, at: Array) -> Array:
    """Eigenvalues of P⁻¹H on some voxels; also that P⁻¹ is symmetric."""
    own = inverse[np.ix_(at, at)]
    assert np.abs(own - own.T).max() < 1e-2 * np.abs(own).max()
    exact = np.linalg.inv(H[np.ix_(at, at)])
    return np.asarray(scipy.linalg.eigh((own + own.T) / 2, exact, eigvals_only=True))


@pytest.mark.parametrize("strength", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("anchor", [1e-2, 1.0])
def test_differences_of_neighbours_are_solved_to_a_factor(
    strength: float, anchor: float
) -> None:
    """H = s A/R + ε with A the symmetric operator: what L's own rows would give."""
    A = LAPLACE.radii[:, None] * -LAPLACE.L.toarray()
    root = np.sqrt(LAPLACE.radii)
    H = strength * A / np.outer(root, root) + anchor * strength * np.eye(V)
    own = strength * -LAPLACE.L.diagonal()
    apply = by_differences(LAPLACE, own, anchor * strength, NONE_FIXED)
    ratios = band(written_out(apply), H, np.flatnonzero(LAPLACE.free))
    assert 0.5 < ratios.min() <= ratios.max() < 1.5


def test_forward_differences_are_solved_within_a_band() -> None:
    """Total variation's own rows, whose conductances are not quite those of L."""
    D = difference_rows(SCENE.voxmap.grid)
    H = (D.T @ D).toarray()
    anchor = 1e-2 * float(np.median(np.diag(H)))
    apply = by_differences(LAPLACE, np.diag(H), anchor, NONE_FIXED)
    H = H + anchor * np.eye(V)
    free = np.flatnonzero(LAPLACE.free)
    ratios = band(written_out(apply), H, free)
    # far below what the diagonal alone leaves
    by_diagonal = scipy.linalg.eigvalsh(
        H[np.ix_(free, free)], np.diag(np.diag(H)[free])
    )
    assert ratios.max() / ratios.min() < 0.5 * by_diagonal.max() / by_diagonal.min()


def test_voxels_outside_the_operator_take_their_diagonal() -> None:
    rng = np.random.default_rng(0)
    own = rng.uniform(0.5, 2.0, V)
    fixed = rng.uniform(size=V) < 0.2
    apply, v = by_differences(LAPLACE, own, 0.3, fixed), rng.normal(size=V)
    outside = ~LAPLACE.free | fixed
    np.testing.assert_allclose(apply(v)[outside], (v / (own + 0.3))[outside])


@pytest.mark.parametrize(
    ("weight", "soft"),
    [(0.0, False), (1e-2, False), (1e2, False), (1e4, False), (0.0, True)],
)
def test_squares_of_laplace_s_rows_are_solved_to_a_factor(
    weight: float, soft: bool
) -> None:
    """H = LᵀΩ⁻¹L + w I, Ω four times as large in the outer layers.

    Of boundary values that may move only L's own rows are matched.
    """
    layer, _, _ = nodes_of(np.arange(V), SCENE.voxmap.grid.shape)
    compliance, L = np.where(layer < 3, 1.0, 4.0), LAPLACE.L.toarray()
    H = L.T @ (L / compliance[:, None]) + weight * np.eye(V)
    moving = LAPLACE.free | soft
    one = sp.csr_array(sp.eye_array(V, format="csr"))
    wide = [ProgramTerm("ridge", weight, one, np.zeros(V))] if weight else []
    apply = by_laplace(LAPLACE, np.where(moving, compliance, 0.0), wide)
    ratios = band(written_out(apply), H, np.flatnonzero(moving))
    assert 0.7 < ratios.min() <= ratios.max() < 1.6


@pytest.mark.parametrize("weight", [1e-3, 1.0, 1e6])
def test_few_rows_of_any_weight_are_added(weight: float) -> None:
    """Woodbury's formula: after all directions (P + DᵀD)⁻¹ itself."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(V, V)) / np.sqrt(V)
    P = root @ root.T + np.eye(V)
    inverse = np.linalg.inv(P)
    D = np.sqrt(weight) * rng.normal(size=(4, V))
    made = with_few_rows(lambda v: inverse @ v, sp.csr_array(D))
    exact = np.linalg.inv(P + D.T @ D)
    for _ in range(12):  # each adds a direction or none
        made(rng.normal(size=V))
    v = rng.normal(size=V)
    found, expected = made(v), exact @ v
    # in the energy norm: what LEFT allows
    error, H = found - expected, P + D.T @ D
    assert error @ H @ error <= (2.0 * LEFT) ** 2 * (expected @ H @ expected)
