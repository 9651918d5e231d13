"""The dual of eq. 10: one equation per measured row, none per voxel.

With D₀ the measured rows, w the square roots of their weights (over the prior's),
D = wD₀, and ω the compliance of each Laplace row (1 for a soft row, 0 for one that must
hold exactly, 1/s² for one scaled by s), the minimiser of Σ (L p - b)²/ω + ‖D p - t‖² is

    p = p₀ + L⁻¹ ω L⁻ᵀ Dᵀ y,   p₀ = L⁻¹b,
    S y = t - D p₀,            S = I + D L⁻¹ ω L⁻ᵀ Dᵀ.

S is the Schur complement of the field in the optimality conditions. It is symmetric
positive definite; a product with it takes one solve with Lᵀ and one with L.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.gaussian.prior import LaplacePrior
from ttus_opt.laplace.system import RTOL, SquareSystem
from ttus_opt.solvers.conjugate_gradients import Map


class SchurComplement:
    """S = I + D P⁻¹Dᵀ of some rows D over a prior P.

    Attributes:
        rows: D₀, rows without weights, shape (m, V).
        root_weights: w, D = w D₀, shape (m,) [–].
    """

    rows: sp.csr_array
    root_weights: Array

    def __init__(self, inverse: Map, rows: sp.csr_array, root_weights: Array) -> None:
        """Take rows over a prior whose inverse is a given linear map."""
        self.inverse, self.rows, self.root_weights = inverse, rows, root_weights

    def prior(self, r: Array, rtol: float = RTOL) -> Array:
        """P⁻¹r, shape (V,)."""
        return self.inverse(r)

    @cached_property
    def adjoint(self) -> sp.csr_array:
        """D₀ᵀ."""
        return sp.csr_array(self.rows.T)

    def measure(self, p: Array) -> Array:
        """D p of a field, shape (m,)."""
        return np.asarray(self.root_weights * (self.rows @ p))

    def load(self, y: Array) -> Array:
        """Dᵀy of multipliers y, shape (V,)."""
        return np.asarray(self.adjoint @ (self.root_weights * y))

    def response(self, y: Array, rtol: float = RTOL) -> Array:
        """The response field P⁻¹Dᵀy, shape (V,)."""
        return self.prior(self.load(y), rtol)

    def apply(self, y: Array, rtol: float = RTOL) -> Array:
        """S y with solves to a relative residual, shape (m,)."""
        return y + self.measure(self.response(y, rtol))


@dataclass(frozen=True)
class DualSystem(SchurComplement):
    """The Schur complement S of one problem, over P⁻¹ = L⁻¹ ω L⁻ᵀ.

    Attributes:
        laplace: Solves with L and Lᵀ.
        compliance: ω per Laplace row, shape (V,) [–].
        rows: D₀, measured rows without weights, shape (m, V).
        root_weights: w, shape (m,) [–].
        n_measured: Number of rows, the first ones, that are measurements, not Laplace
            rows left over in a subproblem; None for all.
    """

    laplace: SquareSystem
    compliance: Array = field(repr=False)
    rows: sp.csr_array = field(repr=False)
    root_weights: Array = field(repr=False)
    n_measured: int | None = None

    @property
    def field_prior(self) -> LaplacePrior:
        """The prior of p."""
        return LaplacePrior(self.laplace, self.compliance)

    def prior(self, r: Array, rtol: float = RTOL) -> Array:
        """L⁻¹ ω L⁻ᵀ r, shape (V,)."""
        return LaplacePrior(self.laplace, self.compliance, rtol).times(r)

    def same_rows(self, other: DualSystem) -> bool:
        """Whether two systems differ at most by the weights of their rows."""
        a, b = self.rows, other.rows
        return (
            self.laplace is other.laplace
            and np.array_equal(self.compliance, other.compliance)
            and np.array_equal(a.indptr, b.indptr)
            and np.array_equal(a.indices, b.indices)
            and np.array_equal(a.data, b.data)
        )
