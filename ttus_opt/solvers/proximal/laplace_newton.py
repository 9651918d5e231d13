"""Newton steps where all but a few rows are Laplace's: through the dual.

With W the slopes of Laplace's rows and C those of the few others, a step d minimises

    ½ dᵀ(Lᵀ W L + Dᵀ C D) d + (g + Dᵀy)ᵀ d
        =  ½ Σ W (L d − h)² + ½ ‖C^½ D d − t‖² + const,    h = −W⁻¹ L⁻ᵀ g,

with t = −C^-½ y, which is eq. 10 with the compliance W⁻¹ and measured rows C^½ D:
`DualSolver` solves it with one unknown per row of D. The splitting of the gradient into
g and Dᵀy is free; it is y = y⁺ − v, with multipliers v that balance the other rows, so
that both parts vanish with the step at any weight. With y = 0, the misfit of a heavy
row would make L⁻¹h so large that it nearly cancels against the solution's y.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.penalties import Slope
from ttus_opt.solvers.dual.solver import Accuracy, DualSolver
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.proximal.penalised_rows import group_columns
from ttus_opt.solvers.proximal.problem import PenalisedProblem

#: Relative residual of solves with L, over that of the inexact step [–]
INSIDE = 1e-2


class LaplaceNewton:
    """Newton steps by the dual of Laplace's rows.

    Attributes:
        rtol: Default relative residual of a step [–].
    """

    rtol = 1e-4

    def __init__(self, problem: PenalisedProblem) -> None:
        """Sort the rows of a problem over p alone."""
        self._laplace, self._fixed = problem.program.laplace, problem.fixed
        self._blocks = problem.blocks
        self._free = np.flatnonzero(self._laplace.free)
        self._few = [k for k, b in enumerate(problem.blocks) if b.laplace is None]
        self._rows = [self._blocks[k].matrix for k in self._few]
        #: v of the few blocks, and its value after a full last step
        self._balance: list[Array] | None = None
        self._aim: list[Array] = []

    def step(
        self,
        gradient: Array,
        multipliers: Sequence[Array],
        slopes: Sequence[Slope],
        rtol: float,
        deadline: float | None,
    ) -> tuple[Array, int]:
        """One step.

        Args:
            gradient: g + Dᵀy, shape (V,).
            multipliers: Multipliers y⁺ of every block.
            slopes: Slopes of every block.
            rtol: Relative residual to reach [–].
            deadline: `time.perf_counter` at which to stop; None for never [s].

        Returns:
            d, shape (V,), and the directions spent.
        """
        laplace, compliance = self._laplace, self._compliance(slopes)
        inside = INSIDE * rtol
        if self._balance is None:
            self._balance = self._first_balance(gradient, multipliers)
        rows, roots, y = self._few_rows(multipliers, slopes)
        rest = np.where(self._fixed, 0.0, gradient - rows.T @ y)
        h = -compliance * laplace.solve_adjoint(rest, rtol=inside)
        if not len(roots):
            return laplace.solve(h, rtol=inside), 0
        system = DualSystem(laplace, compliance, rows, roots)
        accuracy = Accuracy(rtol, inside, deadline)
        answer = DualSolver(system).solve(h, -y / roots, accuracy)
        self._aim, at = [multipliers[k].copy() for k in self._few], 0
        change = -roots * answer.y - y
        for aim, k in zip(self._aim, self._few, strict=True):
            own = slopes[k].factor > 0.0
            end = at + int(own.sum())
            # the dual's own multipliers: those of C D d contain its residual
            aim[own] += change[at:end]
            at = end
        return answer.p, answer.steps

    def taken(self, length: float) -> None:
        """Move v by the step length [–]."""
        if self._balance is not None and self._aim:
            for v, aim in zip(self._balance, self._aim, strict=True):
                v += length * (aim - v)

    def _first_balance(
        self, gradient: Array, multipliers: Sequence[Array]
    ) -> list[Array]:
        """y⁺ where it nearly balances the other rows, else zero."""
        own = [multipliers[k] for k in self._few]
        prior = gradient - np.sum(
            [matrix.T @ y for matrix, y in zip(self._rows, own, strict=True)], axis=0
        )
        near = np.linalg.norm(gradient) < np.linalg.norm(
            np.where(self._fixed, 0.0, prior)
        )
        return [y.copy() if near else np.zeros_like(y) for y in own]

    def _compliance(self, slopes: Sequence[Slope]) -> Array:
        """1/W of every row of L, shape (V,); zero at given values."""
        W = np.zeros(len(self._fixed))
        for slope, b in zip(slopes, self._blocks, strict=True):
            if b.laplace is None:
                continue
            at = np.arange(len(W)) if len(slope.factor) == len(W) else self._free
            scale = 1.0 if b.laplace.scale is None else b.laplace.scale[at]
            W[at] += scale**2 * slope.factor
        return np.where(self._fixed, 0.0, 1.0 / np.where(W > 0.0, W, 1.0))

    def _few_rows(
        self, multipliers: Sequence[Array], slopes: Sequence[Slope]
    ) -> tuple[sp.csr_array, Array, Array]:
        """Few rows with a nonzero slope, the roots of their slopes, and y⁺ − v."""
        assert self._balance is not None
        matrices, roots, own = [], [], []
        for k, matrix, v in zip(self._few, self._rows, self._balance, strict=True):
            slope, y = slopes[k], multipliers[k] - v
            bent = slope.factor > 0.0
            if slope.along is not None:
                matrix = _across(matrix, slope)
                y = Slope(np.ones_like(y), slope.along, slope.size).times(y)
            matrices.append(matrix[bent])
            roots.append(np.sqrt(slope.factor[bent]))
            own.append(y[bent])
        if not matrices:
            return sp.csr_array((0, len(self._fixed))), np.zeros(0), np.zeros(0)
        stacked = sp.csr_array(sp.vstack(matrices, format="csr"))
        return stacked, np.concatenate(roots), np.concatenate(own)


def _across(matrix: sp.csr_array, slope: Slope) -> sp.csr_array:
    """(I − n nᵀ) M with the unit vectors n of a slope's groups."""
    assert slope.along is not None
    unit = group_columns(slope.along, slope.size)
    return sp.csr_array(matrix - unit @ (sp.csr_array(unit.T) @ matrix))
