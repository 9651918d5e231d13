"""Preconditioners of Newton's matrix where rows lie over all voxels.

H = Σ MᵀC M is approximated on every field by an operator with a multigrid. Except in
the network, slopes are those without kinks (few rows lie beyond one):

- where squares of Laplace's rows determine the field: (L − X)ᵀΩ⁻¹(L − X), X matched to
  the other rows (`ttus_opt.solvers.primal.matching`);
- otherwise, for differences of neighbours: their network of conductances, with rows
  beyond a kink cut (`ttus_opt.laplace.network`);
- otherwise R^½ (A + R ε)⁻¹ R^½ over the strength of the differences, whose graph has
  the conductances of A up to the volume R of a voxel; ε is the proximal term.

Few rows D of any weight are added by their Schur complement S = I + D P⁻¹Dᵀ, whose
conjugate directions are kept while P and the weights stay the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.laplace.multigrid.coarsening import Added
from ttus_opt.laplace.multigrid.one_cycle import OneCycle
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.solvers.conjugate_gradients import Map
from ttus_opt.solvers.dual.system import OverPrior
from ttus_opt.solvers.primal.approximate_system import ApproximateLaplace
from ttus_opt.solvers.primal.matching import matched_root
from ttus_opt.solvers.primal.preconditioner import ConstraintPreconditioner

#: Residual of S's system over the energy norm of its solution [–]
LEFT = 0.03


def by_differences(
    laplace: LaplaceSystem, diagonal: Array, anchor: float, fixed: Mask
) -> Map:
    """P⁻¹ where differences of neighbours determine the field.

    Args:
        laplace: L, with the same graph.
        diagonal: Diagonal of H without kinks and ε, shape (V,).
        anchor: ε.
        fixed: Voxels whose values are given, shape (V,).
    """
    free = laplace.free & ~fixed
    own = -laplace.L.diagonal()
    ratio = (diagonal / own)[free]
    strength = float(np.median(ratio[ratio > 0.0])) if (ratio > 0.0).any() else 1.0
    grid = laplace.operator_grid
    layers = laplace.radii.reshape(grid.shape)[:, 0, 0] * (anchor / strength)
    added = Added.in_layers(layers, grid.shape, laplace.grounds)
    cycle = OneCycle(grid, laplace.free, added)
    root = np.where(free, np.sqrt(laplace.radii), 0.0)
    alone = np.where(diagonal + anchor > 0.0, diagonal + anchor, 1.0)

    def apply(v: Array) -> Array:
        return np.where(free, root * cycle.solve(root * v).x / strength, v / alone)

    return apply


def by_laplace(
    laplace: LaplaceSystem, compliance: Array, wide: Sequence[ProgramTerm]
) -> Map:
    """P⁻¹ where squares of Laplace's rows determine the field.

    Args:
        laplace: L.
        compliance: Ω, shape (V,).
        wide: The other rows over the voxels, without kinks.
    """
    grid, free = laplace.operator_grid, laplace.free
    root = matched_root(wide, grid, free, laplace.radii, compliance)
    cycle = OneCycle(grid, free, root.added, grounds=laplace.grounds)
    approximate = ApproximateLaplace.of(laplace, cycle, root.coupling)

    def apply(v: Array) -> Array:
        return approximate.solve(compliance * approximate.solve_adjoint(v))

    return apply


def with_few_rows(prior: Map, rows: sp.csr_array) -> Map:
    """(P + DᵀD)⁻¹ from P⁻¹, approximately.

    Args:
        prior: P⁻¹, linear.
        rows: D, times the roots of its slopes, shape (m, n).
    """
    m = rows.shape[0]
    system = OverPrior(prior, rows, np.ones(m))
    return ConstraintPreconditioner(system, np.zeros((m, 0)), LEFT).field
