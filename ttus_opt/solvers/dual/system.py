"""The dual of eq. 10: one equation per measured row, none per voxel.

With D₀ the measured rows, c the roots of their weights (over the prior's), D = cD₀,
and ω per Laplace row (1 where the row is soft, 0 where it must hold exactly, 1/s²
where it is scaled by s), the minimiser of Σ (L p - b)²/ω + ‖D p - t‖² is

    p = p₀ + L⁻¹ ω L⁻ᵀ Dᵀ y,   p₀ = L⁻¹b,
    (I + K) y = t - D p₀,      K = D L⁻¹ ω L⁻ᵀ Dᵀ.

K is symmetric positive semidefinite; applying it is one solve with Lᵀ and one with L.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.laplace.square_system import RTOL, SquareSystem


@dataclass(frozen=True)
class DualSystem:
    """The operator I + K of one problem.

    Attributes:
        laplace: Solves with L and Lᵀ.
        softness: ω per Laplace row, shape (V,) [–].
        rows: D₀, measured rows without weights, shape (m, V).
        root_weights: c, shape (m,) [–].
        n_measured: How many of them, the first ones, are measurements and no rows left
            over on a face; None for all.
    """

    laplace: SquareSystem
    softness: Array = field(repr=False)
    rows: sp.csr_array = field(repr=False)
    root_weights: Array = field(repr=False)
    n_measured: int | None = None
    adjoint: sp.csr_array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Transpose the rows once."""
        object.__setattr__(self, "adjoint", sp.csr_array(self.rows.T))

    def measure(self, p: Array) -> Array:
        """Weighted measurements D p of a field, shape (m,)."""
        return np.asarray(self.root_weights * (self.rows @ p))

    def response(self, y: Array, rtol: float = RTOL) -> Array:
        """The field L⁻¹ ω L⁻ᵀ Dᵀ y that multipliers y make, shape (V,)."""
        load = self.adjoint @ (self.root_weights * y)
        slope = self.laplace.solve_adjoint(load, rtol=rtol)
        return self.laplace.solve(self.softness * slope, rtol=rtol)

    def apply(self, y: Array, rtol: float = RTOL) -> Array:
        """(I + K) y with solves to a relative residual, shape (m,)."""
        return y + self.measure(self.response(y, rtol))

    def same_rows(self, other: DualSystem) -> bool:
        """Whether K differs from another's by the weights of its rows at most."""
        a, b = self.rows, other.rows
        return (
            self.laplace is other.laplace
            and a.shape == b.shape
            and np.array_equal(self.softness, other.softness)
            and np.array_equal(a.indptr, b.indptr)
            and np.array_equal(a.indices, b.indices)
            and np.array_equal(a.data, b.data)
        )
