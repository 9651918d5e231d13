"""A Gaussian prior with weighted measured rows, and the error of its fit.

With C the prior's covariance, D the measured rows times the square roots of their
weights and BᵀB = D C Dᵀ, (1 + D C Dᵀ)⁻¹ = 1 − XᵀX with X = E⁻¹B, E Eᵀ = 1 + BBᵀ. B has
as many rows as there are independent measurements of the field.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.fitting.uncertainty.wrench_noise import ErrorModel

Float32Array = NDArray[np.float32]

#: 95 % of a normal distribution lie within so many standard deviations [–]
NORMAL = 1.959964


@dataclass(frozen=True)
class WeightedData:
    """Measurements in terms of B.

    Attributes:
        weighted: B, shape (k, rows).
        misfit: Measurement minus the prior's mean, times the square roots of the
            weights, (rows,).
        half: X, shape (k, rows).
        log_determinant: log det(1 + BBᵀ) [–].
    """

    weighted: Array = field(repr=False)
    misfit: Array = field(repr=False)
    half: Array = field(repr=False)
    log_determinant: float

    @classmethod
    def of(cls, weighted: Array, misfit: Array) -> WeightedData:
        """Factorise 1 + BBᵀ."""
        gram = weighted @ weighted.T
        gram[np.diag_indices_from(gram)] += 1.0
        lower = np.linalg.cholesky(gram)
        half = scipy.linalg.solve_triangular(lower, weighted, lower=True)
        return cls(weighted, misfit, half, 2.0 * float(np.log(np.diag(lower)).sum()))

    def solve(self, values: Array) -> Array:
        """(1 + BᵀB)⁻¹ values, shape (rows,)."""
        return np.asarray(values - self.half.T @ (self.half @ values))


@dataclass(frozen=True)
class Posterior(abc.ABC):
    """The error of a fit, given the errors of its prior and its measurements.

    Attributes:
        informative: Rows of the problem that depend on the field, shape (m,).
        measured: Their measurements.
        errors: Prior variance and noise of the rows; None until they are known.
    """

    informative: Mask = field(repr=False)
    measured: WeightedData = field(repr=False)
    errors: ErrorModel | None = field(default=None, repr=False, kw_only=True)

    def with_errors(self, errors: ErrorModel) -> Self:
        """The same with known errors of prior and measurements."""
        return replace(self, errors=errors)

    @abc.abstractmethod
    def covariance(self, rows: sp.csr_array, height: int) -> Array:
        """Covariance of blocks of rows of the field, (k, height, height)."""

    @abc.abstractmethod
    def draw(self, count: int, voxels: IntArray | None = None) -> Float32Array:
        """Draws of the fit's error, shape (count, n).

        Args:
            count: Number of draws [–].
            voxels: Voxels of the draws, shape (n,); None for all.
        """


def kept_rows(
    rows: sp.csr_array, voxels: IntArray, height: int
) -> tuple[sp.csr_array, Mask]:
    """Rows of a field over some voxels only.

    Args:
        rows: Rows of a field, shape (k · height, V).
        voxels: The voxels, shape (n,).
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
