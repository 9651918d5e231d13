"""The Gaussian prior of a Laplace term: white noise ω through L.

‖L p − b‖²/ω is −2 times the log density of p = L⁻¹(b + √ω w), w white noise, up to a
constant. Its covariance C = L⁻¹ω L⁻ᵀ takes a solve with Lᵀ and one with L.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.gaussian.prior import Prior
from ttus_opt.laplace.system import RTOL, SquareSystem


@dataclass(frozen=True)
class LaplacePrior(Prior):
    """C = L⁻¹ω L⁻ᵀ.

    Attributes:
        laplace: Solves with L and Lᵀ.
        compliance: ω per row of L, shape (V,) [–].
        rtol: Relative residual of the solves [–].
    """

    laplace: SquareSystem = field(repr=False)
    compliance: Array = field(repr=False)
    rtol: float = RTOL

    def times(self, values: Array) -> Array:
        """Implements `Prior`, by two solves."""
        slope = self.laplace.solve_adjoint(values, rtol=self.rtol)
        return self.laplace.solve(self.compliance * slope, rtol=self.rtol)

    def square(self, values: Array) -> float:
        """Implements `Prior`, by one solve."""
        slope = self.laplace.solve_adjoint(values, rtol=self.rtol)
        return float((self.compliance * slope) @ slope)

    def within(self, rtol: float) -> Self:
        """Implements `Prior`."""
        return replace(self, rtol=rtol)

    def among_rows(self, rows: sp.csr_array, height: int) -> Array:
        """Implements `Prior`, by a solve per nonempty row."""
        root, out = np.sqrt(self.compliance), []
        for first in range(0, rows.shape[0], height):
            some = rows[first : first + height]
            half = np.zeros(some.shape)
            for i in np.flatnonzero(np.diff(some.indptr)):
                load = some[[i]].toarray()[0]
                half[i] = root * self.laplace.solve_adjoint(load, rtol=self.rtol)
            out.append(half @ half.T)
        return np.array(out).reshape(-1, height, height)

    def draw(self, rng: np.random.Generator) -> Array:
        """Implements `Prior`, by a solve."""
        noise = np.sqrt(self.compliance) * rng.standard_normal(len(self.compliance))
        return self.laplace.solve(noise, rtol=self.rtol)
