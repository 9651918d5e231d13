"""Rows under a penalty or between limits, in the augmented Lagrangian.

With r = M x − t, weight w, multiplier estimate y and a parameter σ a row block adds

    e(x) = min_z w φ(z) + σ/2 ‖r − z + y/σ‖²,      ∇e = Mᵀ y⁺,

where y⁺ = w g and g is the `resolvent` of φ at (y + σ r)/w, of step σ/w. Smooth
penalties (squares, Huber's) enter exactly, which is σ → ∞ and needs no estimate.

Source: R. T. Rockafellar, Augmented Lagrangians and Applications of the Proximal Point
Algorithm in Convex Programming (1976).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.terms.penalties import Penalty, Slope, Squares
from ttus_opt.problem.terms.structure import LaplaceRows
from ttus_opt.solvers.conjugate_gradients import inner_product

#: σ over the weight of a smooth penalty; the difference to σ → ∞ is below rounding
EXACT = 1e15


@dataclass(frozen=True)
class Between:
    """The indicator of lower ≤ r ≤ upper.

    Attributes:
        lower: Shape (m,).
        upper: Shape (m,).
    """

    lower: Array
    upper: Array

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """As `Penalty.resolvent`: the excess of v over step · [lower, upper]."""
        outside = (v < step * self.lower) | (v > step * self.upper)
        g = np.where(outside, v - np.clip(v, step * self.lower, step * self.upper), 0.0)
        return g, Slope(outside.astype(float))


class PenalisedRows:
    """Rows, their law, and the estimate of their multipliers.

    Attributes:
        name: Name of the term or constraint.
        matrix: M, shape (m, n).
        target: t, shape (m,).
        weight: w [–].
        law: Penalty or limits.
        exact: Whether the penalty is smooth and enters exactly.
        sigma: σ.
        measured: Whether they are measurements.
        laplace: How they are Laplace's rows; None for others.
        multipliers: y, shape (m,).
    """

    def __init__(
        self,
        name: str,
        matrix: sp.csr_array,
        target: Array,
        weight: float,
        law: Penalty | Between,
        exact: bool = False,
    ) -> None:
        self.name, self.matrix, self.target = name, matrix, target
        self.weight, self.law, self.exact = weight, law, exact
        self.sigma, self.measured = EXACT * weight, False
        self.laplace: LaplaceRows | None = None
        self.multipliers = np.zeros(len(target))

    @classmethod
    def of(cls, term: ProgramTerm) -> PenalisedRows:
        """The rows of a term."""
        smooth = term.penalty.smooth
        rows = cls(
            term.name, term.matrix, term.target, term.weight, term.penalty, smooth
        )
        rows.measured, rows.laplace = term.is_measured, term.laplace_rows
        return rows

    @property
    def nnz(self) -> float:
        """Mean entries of a row [–]."""
        return self.matrix.nnz / max(len(self.target), 1)

    def residual(self, x: Array) -> Array:
        """M x − t, shape (m,)."""
        return np.asarray(self.matrix @ x - self.target)

    def charged(self, r: Array) -> tuple[Array, Slope]:
        """Multipliers y⁺ at a residual, shape (m,), and their slope by r."""
        v = (self.multipliers + self.sigma * r) / self.weight
        g, slope = self.law.resolvent(v, self.sigma / self.weight)
        steeper = Slope(self.sigma * slope.factor, slope.along, slope.size)
        return self.weight * g, steeper

    def adjoint(self, y: Array) -> Array:
        """Mᵀ y, shape (n,)."""
        return np.asarray(self.matrix.T @ y)

    def moved(self, r: Array, y: Array) -> float:
        """What a round moved to a residual and multipliers, as the Lagrangian's e."""
        change = y - self.multipliers
        return 0.0 if self.exact else inner_product(change, change) / self.sigma

    def follow(self, x: Array, y: Array, growth: float) -> None:
        """Take y as the estimate of the next round, and let σ grow by a factor."""
        if not self.exact:
            self.multipliers = y
            self.sigma *= growth


class Anchor(PenalisedRows):
    """The proximal term w ‖E (x − x̄)‖², which keeps x where nothing else does."""

    def __init__(self, rows: sp.csr_array, laplace: LaplaceRows | None = None) -> None:
        """Take E, which may be Laplace's rows."""
        zero = np.zeros(rows.shape[0])
        super().__init__("proximal term", rows, zero, 1.0, Squares(), exact=True)
        self.laplace = laplace

    def weigh(self, weight: float) -> None:
        """Take another weight w."""
        self.weight, self.sigma = weight, EXACT * weight

    def moved(self, r: Array, y: Array) -> float:
        """What a round moved x, likewise."""
        return self.weight * inner_product(r, r)

    def follow(self, x: Array, y: Array, growth: float) -> None:
        """Go along to x, and let go as σ grows."""
        self.target = np.asarray(self.matrix @ x)
        self.weigh(self.weight / growth)


def group_columns(values: Array, size: int) -> sp.csr_array:
    """Values as columns, one for each group of ``size`` rows, shape (m, m / size)."""
    m = len(values)
    group, starts = np.repeat(np.arange(m // size), size), np.arange(m + 1)
    return sp.csr_array((values, group, starts), shape=(m, m // size))
