"""Newton steps where all but a few rows are Laplace's: through the dual.

With W the slopes of Laplace's rows and C those of the few others, a step d minimises

    ½ dᵀ(Lᵀ W L + Dᵀ C D) d + gᵀ d  =  ½ Σ W (L d − h)² + ½ ‖C^½ D d‖² + const,
    h = −W⁻¹ L⁻ᵀ g,

which is eq. 10 with the compliance W⁻¹ and measured rows C^½ D: `DualSolver` solves it
with as many unknowns as there are few rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array, Mask
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.solvers.dual.options import Accuracy, DualOptions
from ttus_opt.solvers.dual.solver import DualSolver
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.proximal.penalised_rows import PenalisedRows, group_columns
from ttus_opt.terms.penalties.base import Slope
from ttus_opt.terms.structure import LaplaceRows

#: Relative residual of solves with L in a step that is itself inexact, over its own
INSIDE = 1e-2

#: No product with the dual is asked for less than this relative residual [–]
LOOSEST = 1e-4


class LaplaceNewton:
    """Newton steps by the dual of Laplace's rows.

    Attributes:
        rtol: Relative residual to which a step is best solved [–].
    """

    rtol = 1e-4

    def __init__(
        self,
        laplace: LaplaceSystem,
        blocks: Sequence[PenalisedRows],
        declared: Sequence[LaplaceRows | None],
        fixed: Mask,
    ) -> None:
        """Sort the rows.

        Args:
            laplace: L.
            blocks: All rows.
            declared: Which of them are Laplace's.
            fixed: Voxels whose values are given, shape (V,).
        """
        self._laplace, self._fixed = laplace, fixed
        self._declared = declared
        self._free = np.flatnonzero(laplace.free)
        self._few = [k for k, rows in enumerate(declared) if rows is None]
        self._rows = [blocks[k].matrix for k in self._few]
        self._options = replace(DualOptions(), loosest_product=LOOSEST)

    def step(
        self,
        gradient: Array,
        slopes: Sequence[Slope],
        rtol: float,
        deadline: float | None,
    ) -> tuple[Array, int]:
        """One step.

        Args:
            gradient: g, shape (V,).
            slopes: Of every block.
            rtol: Relative residual to reach [–].
            deadline: `time.perf_counter` at which to stop; None for never [s].

        Returns:
            d, shape (V,), and the directions spent.
        """
        laplace, compliance = self._laplace, self._compliance(slopes)
        inside = INSIDE * rtol
        slope = laplace.solve_adjoint(np.where(self._fixed, 0.0, gradient), rtol=inside)
        h = -compliance * slope
        rows, roots = self._roots(slopes)
        if not len(roots):
            return laplace.solve(h, rtol=inside), 0
        system = DualSystem(laplace, compliance, rows, roots)
        solver = DualSolver(system, options=self._options)
        accuracy = Accuracy(rtol, inside, deadline)
        answer = solver.solve(h, np.zeros(len(roots)), accuracy)
        return answer.p, answer.steps

    def _compliance(self, slopes: Sequence[Slope]) -> Array:
        """1/W of every row of L; zero where the voxel's value is given."""
        W = np.zeros(len(self._fixed))
        for slope, rows in zip(slopes, self._declared, strict=True):
            if rows is None:
                continue
            at = np.arange(len(W)) if len(slope.factor) == len(W) else self._free
            scale = 1.0 if rows.scale is None else rows.scale[at]
            W[at] += scale**2 * slope.factor
        return np.where(self._fixed, 0.0, 1.0 / np.where(W > 0.0, W, 1.0))

    def _roots(self, slopes: Sequence[Slope]) -> tuple[sp.csr_array, Array]:
        """Few rows whose slope is not zero, and the roots of their slopes."""
        matrices, roots = [], []
        for k, matrix in zip(self._few, self._rows, strict=True):
            slope = slopes[k]
            bent = slope.factor > 0.0
            if slope.along is not None:
                matrix = _across(matrix, slope)
            matrices.append(matrix[bent])
            roots.append(np.sqrt(slope.factor[bent]))
        if not matrices:
            return sp.csr_array((0, len(self._fixed))), np.zeros(0)
        return sp.csr_array(sp.vstack(matrices, format="csr")), np.concatenate(roots)


def _across(matrix: sp.csr_array, slope: Slope) -> sp.csr_array:
    """(I − n nᵀ) M with the unit vectors n of a slope's groups."""
    assert slope.along is not None
    unit = group_columns(slope.along, slope.size)
    return sp.csr_array(matrix - unit @ (sp.csr_array(unit.T) @ matrix))
