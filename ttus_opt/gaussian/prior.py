"""Gaussian priors of a field over the voxels: N(0, C) about a mean of their own.

C is a matrix over all voxels and never formed: a prior multiplies by it, evaluates it
among rows of a field, and draws fields.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.laplace.system import RTOL, SquareSystem


class Prior(abc.ABC):
    """A Gaussian field of covariance C."""

    @abc.abstractmethod
    def times(self, values: Array) -> Array:
        """C values, shape (V,)."""

    @abc.abstractmethod
    def among_rows(self, rows: sp.csr_array, height: int) -> Array:
        """Covariance of consecutive rows of the field.

        Args:
            rows: Shape (k · height, V).
            height: Rows of a block [–].

        Returns:
            The blocks, shape (k, height, height).
        """

    @abc.abstractmethod
    def draw(self, rng: np.random.Generator) -> Array:
        """A field of this covariance and mean zero, shape (V,)."""

    def square(self, values: Array) -> float:
        """Variance of a row of the field."""
        return float(values @ self.times(values))

    def within(self, rtol: float) -> Self:
        """The same by solves to a relative residual, where there are solves."""
        return self


@dataclass(frozen=True)
class LaplacePrior(Prior):
    """That of a Laplace term, white noise ω through L: C = L⁻¹ω L⁻ᵀ.

    ‖L p − b‖²/ω is −2 times the log density of p = L⁻¹(b + √ω w), w white noise, up to
    a constant. C takes a solve with Lᵀ and one with L.

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


def square_root(matrix: Array, neglected: float = 0.0) -> Array:
    """F with F Fᵀ = matrix, positive semidefinite, without rounding errors.

    Args:
        matrix: Shape (n, n).
        neglected: Part of the largest diagonal entry that may be left.
    """
    least = neglected * float(np.diag(matrix).max(initial=0.0)) if neglected else -1.0
    return pivoted_root(matrix, least)[0]


def pivoted_root(matrix: Array, least: float) -> tuple[Array, IntArray]:
    """The same, triangular in the rows of its pivots, and these in order.

    By Cholesky's decomposition with pivots, which ends where nothing is left: a
    twentieth of the time of an eigendecomposition.

    Args:
        matrix: Shape (n, n).
        least: Largest diagonal entry that may be left; below 0 that of rounding.
    """
    factor, order, rank, _ = scipy.linalg.lapack.dpstrf(matrix, tol=least, lower=1)
    if not np.diag(matrix).max(initial=0.0) > least:  # it always takes the first
        rank = 0
    root = np.empty((len(matrix), rank))
    root[order - 1] = np.tril(factor[:, :rank])
    return root, order[:rank].astype(np.int64) - 1


#: Pivots sought at once [–], and part of the largest variance left that one must have:
#: 3 % more pivots than one at a time
PIVOTS, PART = 256, 0.1


def partial_root(
    variance: Array, columns: Callable[[IntArray], Array], neglected: float
) -> Array:
    """F with F Fᵀ nearly a matrix that is not formed, positive semidefinite.

    As `square_root`, with the memory of F: Cholesky's decomposition with blocks of
    pivots, those of the largest variances left.

    Args:
        variance: Its diagonal, shape (n,).
        columns: Gives some of its columns, shape (n, k).
        neglected: Part of the largest diagonal entry that may be left, positive.
    """
    left, least = variance.copy(), neglected * float(variance.max(initial=0.0))
    root, rank = np.empty((0, len(left))), 0
    while left.max(initial=0.0) > least:
        some = np.argsort(left)[-PIVOTS:]
        rest = columns(some) - root[:rank].T @ root[:rank, some]
        enough = max(least, PART * float(left.max()))
        left[some] = np.diag(rest[some])  # not what is left by rounding
        own, pivots = pivoted_root(rest[some], enough)
        more = scipy.linalg.solve_triangular(own[pivots], rest[:, pivots].T, lower=True)
        if rank + len(pivots) > len(root):
            room = np.empty((max(PIVOTS, rank), len(left)))
            root = np.concatenate([root, room])
        root[rank : rank + len(pivots)] = more
        rank += len(pivots)
        left -= np.einsum("ij,ij->j", more, more)
        left[some[pivots]] = 0.0
    return root[:rank].T
