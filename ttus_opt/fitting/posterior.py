"""A Gaussian prior and weighted measured rows: what the fit's error is made of.

With C the prior's covariance, D the measured rows times their weights' roots
and BᵀB = D C Dᵀ, (1 + D C Dᵀ)⁻¹ = 1 − XᵀX with X = L⁻¹B, L Lᵀ = 1 + BBᵀ: all that is
needed of the measurements is B, with as many rows as they tell of the field.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.fitting.wrench_noise import ErrorModel

Single = NDArray[np.float32]

#: 95 % of a normal distribution lie within so many standard deviations [–]
NORMAL = 1.959964


class Posterior(Protocol):
    """The error of a fit, given the errors of what it was fitted to."""

    @property
    def told(self) -> Mask:
        """Rows of the problem that say something of the field, shape (m,)."""

    @property
    def measured(self) -> MeasuredRows:
        """What they say."""

    def with_errors(self, errors: ErrorModel) -> Posterior:
        """The same with the prior's variance and the rows' noise as they are."""

    def covariance(self, rows: sp.csr_array, height: int) -> Array:
        """Covariance of blocks of rows of the field, (k, height, height)."""

    def draw(self, count: int, voxels: IntArray | None = None) -> Single:
        """Draws of the fit's error, at some voxels or all, (count, n)."""


def kept_rows(
    rows: sp.csr_array, voxels: IntArray, height: int
) -> tuple[sp.csr_array, Mask]:
    """Rows of a field over some voxels only.

    Args:
        rows: Shape (k · height, V).
        voxels: Shape (n,).
        height: Rows of a block [–].

    Returns:
        The rows over these voxels, (k · height, n), and which blocks touch others,
        (k,).
    """
    place = np.full(rows.shape[1], -1, dtype=np.int64)
    place[voxels] = np.arange(len(voxels))
    column = place[rows.indices]
    missing = np.zeros(rows.shape[0] // height, dtype=bool)
    block = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr)) // height
    missing[block[column < 0]] = True
    few = (rows.shape[0], len(voxels))
    kept = sp.csr_array((rows.data, np.maximum(column, 0), rows.indptr), few)
    return kept, missing


@dataclass(frozen=True)
class MeasuredRows:
    """What the measurements say, as weighted.

    Attributes:
        weighted: B, shape (k, rows).
        misfit: What was measured beyond the prior's mean, times the weights' roots,
            shape (rows,).
        half: X, shape (k, rows).
    """

    weighted: Array = field(repr=False)
    misfit: Array = field(repr=False)
    half: Array = field(repr=False)

    @classmethod
    def of(cls, weighted: Array, misfit: Array) -> MeasuredRows:
        """Factorise 1 + BBᵀ."""
        gram = weighted @ weighted.T
        gram[np.diag_indices_from(gram)] += 1.0
        lower = np.linalg.cholesky(gram)
        half = scipy.linalg.solve_triangular(lower, weighted, lower=True)
        return cls(weighted, misfit, half)

    def solve(self, values: Array) -> Array:
        """(1 + BᵀB)⁻¹ values, shape (rows,)."""
        return np.asarray(values - self.half.T @ (self.half @ values))
