"""Measurements d ~ N(0, S) of a Gaussian field: what they say of it, and how likely.

d is what was measured less what the prior's mean says, and S the covariance of the
measured rows D by the prior plus that of their noise. With weighted rows, whose noise
is 1, and images B with BᵀB = D C Dᵀ, S = 1 + BᵀB is known by the smaller M = 1 + BBᵀ,

    S⁻¹ = 1 − BᵀM⁻¹B = 1 − XᵀX,   det S = det M,   X = E⁻¹B,   E Eᵀ = M

(Sherman, Morrison, Woodbury). B has as many rows as there are independent measurements.
All else follows from S⁻¹:

- the estimate p̄ + C Dᵀ a of the field, a = S⁻¹d the multipliers of the measurements;
- the evidence −½ (dᵀa + log det S), up to a constant;
- the errors (S⁻¹_FF)⁻¹ a_F of predicting some rows F from all others.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), eqs. 2.25, 2.30, A.9 and section 5.4.2.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np
import scipy.linalg

from ttus_opt.core.arrays import Array, IntArray


@dataclass(frozen=True)
class Conditioned(abc.ABC):
    """Measurements and a factor of their covariance.

    Attributes:
        data: d, shape (m,).
        factor: Lower Cholesky factor of S or M.
    """

    data: Array = field(repr=False)
    factor: Array = field(repr=False)

    @abc.abstractmethod
    def solve(self, values: Array) -> Array:
        """S⁻¹ values, shape (m,) or (m, n)."""

    @abc.abstractmethod
    def _among(self, rows: IntArray, values: Array) -> Array:
        """(S⁻¹_FF)⁻¹ values for rows F, shape (f,) or (f, n)."""

    @cached_property
    def multipliers(self) -> Array:
        """The multipliers a = S⁻¹d, shape (m,)."""
        return self.solve(self.data)

    @property
    def square(self) -> float:
        """dᵀS⁻¹d [–]."""
        return float(self.data @ self.multipliers)

    @property
    def log_determinant(self) -> float:
        """Logarithm of det S [–]."""
        return 2.0 * float(np.log(np.diag(self.factor)).sum())

    @property
    def log_density(self) -> float:
        """Logarithm of the density of d, but for −½ m log 2π."""
        return -0.5 * (self.square + self.log_determinant)

    def left_out(self, group: IntArray, multipliers: Array | None = None) -> Array:
        """Errors of predicting the rows of every group from all others.

        Args:
            group: Group of every row, shape (m,) [–].
            multipliers: S⁻¹ of other data, shape (m,) or (m, n); None for those of d.

        Returns:
            Measured minus predicted, shaped as the multipliers.
        """
        a = self.multipliers if multipliers is None else multipliers
        errors = np.empty_like(a)
        for number in np.unique(group):
            rows = np.flatnonzero(group == number)
            errors[rows] = self._among(rows, a[rows])
        return errors


@dataclass(frozen=True)
class ByCovariance(Conditioned):
    """Measurements of any covariance S, by a factor of S."""

    @classmethod
    def of(cls, covariance: Array, data: Array) -> Self:
        """Factorise S, shape (m, m)."""
        return cls(data, np.asarray(scipy.linalg.cholesky(covariance, lower=True)))

    def white(self, values: Array) -> Array:
        """E⁻¹ values with S = E Eᵀ, shape (m,) or (m, n)."""
        return np.asarray(
            scipy.linalg.solve_triangular(self.factor, values, lower=True)
        )

    def solve(self, values: Array) -> Array:
        """Implements `Conditioned`."""
        return np.asarray(scipy.linalg.cho_solve((self.factor, True), values))

    @property
    def square(self) -> float:
        """Implements `Conditioned`."""
        return float((self.white(self.data) ** 2).sum())

    def _among(self, rows: IntArray, values: Array) -> Array:
        unit = np.zeros((len(self.data), len(rows)))
        unit[rows, np.arange(len(rows))] = 1.0
        half = self.white(unit)
        return np.asarray(scipy.linalg.solve(half.T @ half, values, assume_a="pos"))


@dataclass(frozen=True)
class ByImages(Conditioned):
    """Measurements d = Bᵀc + e of coefficients c ~ N(0, 1) with noise e ~ N(0, 1).

    Attributes:
        images: B, shape (k, m).
    """

    images: Array = field(repr=False)

    @classmethod
    def of(cls, images: Array, data: Array) -> Self:
        """Factorise M = 1 + BBᵀ."""
        gram = images @ images.T
        gram[np.diag_indices_from(gram)] += 1.0
        return cls(data, np.asarray(np.linalg.cholesky(gram), np.float64), images)

    @cached_property
    def half(self) -> Array:
        """X, shape (k, m)."""
        half = scipy.linalg.solve_triangular(self.factor, self.images, lower=True)
        return np.asarray(half)

    @cached_property
    def spread(self) -> Array:
        """M⁻¹, covariance of the coefficients given the measurements, shape (k, k)."""
        unit = np.eye(len(self.factor))
        return np.asarray(scipy.linalg.cho_solve((self.factor, True), unit))

    def coefficients(self, data: Array) -> Array:
        """Estimate M⁻¹B d of c from some data, (m,) or (m, n); (k,) or (k, n)."""
        return np.asarray(
            scipy.linalg.cho_solve((self.factor, True), self.images @ data)
        )

    @property
    def square(self) -> float:
        """Implements `Conditioned`, without X."""
        seen = self.images @ self.data
        seen = scipy.linalg.solve_triangular(self.factor, seen, lower=True)
        return float(self.data @ self.data - seen @ seen)

    def solve(self, values: Array) -> Array:
        """Implements `Conditioned`."""
        return np.asarray(values - self.half.T @ (self.half @ values))

    def _among(self, rows: IntArray, values: Array) -> Array:
        """By the smaller of two systems."""
        half = self.half[:, rows]
        k, n = half.shape
        if n <= k:
            return np.asarray(scipy.linalg.solve(np.eye(n) - half.T @ half, values))
        inner = scipy.linalg.solve(np.eye(k) - half @ half.T, half @ values)
        return np.asarray(values + half.T @ inner)


def conditioned(images: Array, data: Array) -> Conditioned:
    """Measurements with images B, by the smaller of M and S.

    Args:
        images: B, shape (k, m).
        data: d, shape (m,).
    """
    k, m = images.shape
    if k <= m:
        return ByImages.of(images, data)
    covariance = images.T @ images
    covariance[np.diag_indices_from(covariance)] += 1.0
    return ByCovariance.of(covariance, data)
