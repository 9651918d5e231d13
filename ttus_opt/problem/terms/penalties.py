"""Penalties φ of a residual r.

The optimality conditions use a subgradient, the projection onto the set of all
subgradients, and the conjugate φ*: for g in that set φ(r) + φ*(g) ≥ gᵀr, with equality
exactly where g is a subgradient at r (Fenchel; Rockafellar, Convex Analysis, section
23). Solvers use a cvxpy expression, a `Split` for quadratic programs, or the
`resolvent` for the method of multipliers.
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError


@dataclass(frozen=True, eq=False)
class Slope:
    """Derivative of a resolvent g with respect to v, ∂g = factor (I − n nᵀ) ∂v.

    Attributes:
        factor: Per row, equal within a group, shape (m,) [–].
        along: A unit vector n per group, or zeros, shape (m,); None for zeros [–].
        size: Rows per group [–].
    """

    factor: Array
    along: Array | None = None
    size: int = 1

    def times(self, v: Array) -> Array:
        """The change of g for a change v, shape (m,)."""
        if self.along is None:
            return self.factor * v
        shape = (-1, self.size)
        parts = (self.along * v).reshape(shape).sum(axis=1, keepdims=True)
        v = v - (parts * self.along.reshape(shape)).reshape(-1)
        return self.factor * v


@dataclass(frozen=True)
class Split:
    """A penalty as the minimum of a quadratic program over parts of its residual.

    φ(r) = min over above, below ≥ 0 of  slope · Σ (above + below) + rest, where the
    rest is ‖r − above + below‖², or zero and r = above − below.

    Attributes:
        slope: Cost per unit of each part [–].
        squares_rest: Whether the rest is ‖r − above + below‖².
    """

    slope: float
    squares_rest: bool


@dataclass(frozen=True)
class Penalty(abc.ABC):
    """A convex penalty, nonnegative and zero at zero unless it is linear."""

    #: The mathematics, for `repr`
    formula: ClassVar[str]
    #: Whether it is quadratic or linear
    quadratic: ClassVar[bool] = False
    #: Whether its gradient is continuous and vanishes at zero
    smooth: ClassVar[bool] = False

    @property
    def rows_per_group(self) -> int:
        """Residuals per group; their number must be a multiple of it [–]."""
        return 1

    @property
    def split(self) -> Split | None:
        """Its form as a quadratic program; None without one."""
        return None

    @abc.abstractmethod
    def value(self, r: Array) -> float:
        """Evaluate φ(r).

        Args:
            r: Residuals, shape (m,).
        """

    @abc.abstractmethod
    def subgradient(self, r: Array) -> Array:
        """The subgradient of φ at r with the smallest norm, shape (m,)."""

    @abc.abstractmethod
    def admissible(self, g: Array) -> Array:
        """The nearest multiplier that is a subgradient of φ somewhere, shape (m,)."""

    @abc.abstractmethod
    def conjugate(self, g: Array) -> float:
        """Evaluate φ*(g) of an admissible multiplier."""

    def gauge(self, g: Array) -> float:
        """The smallest t ≥ 0 for which g is t times an admissible multiplier.

        Infinite if not implemented. For non-negative penalties, it and `farthest` give
        a bound of the gap if squares do not determine the solution
        (`ttus_opt.problem.verify.absorption`).
        """
        return math.inf

    def farthest(self, value: float) -> float:
        """An upper bound of ‖r‖ for φ(r) ≤ value; infinite if not implemented."""
        return math.inf

    @abc.abstractmethod
    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """The penalty as a cvxpy expression.

        Args:
            r: A cvxpy expression of the residuals, shape (m,).
            cp: The module cvxpy, imported only where it is used.

        Returns:
            A scalar cvxpy expression.
        """

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """The multiplier g that minimises φ*(g) + ‖g − v‖² / (2 step).

        By Moreau's identity this is (v − z) / step with z the proximal point of φ at
        v / step, of parameter 1 / step; for large steps the gradient of φ at v / step.

        Args:
            v: Shape (m,).
            step: Positive [–].

        Returns:
            g, shape (m,), and its slope, a generalised derivative at a kink.

        Raises:
            InputError: Not implemented for this penalty.
        """
        raise InputError(f"{type(self).__name__} does not implement resolvent()")


@dataclass(frozen=True)
class Squares(Penalty):
    """Σ r², the penalty of eq. 10."""

    formula = "Σ r²"
    quadratic = True
    smooth = True

    def value(self, r: Array) -> float:
        """Σ r²."""
        return float(r @ r)

    def subgradient(self, r: Array) -> Array:
        """2 r."""
        return 2.0 * r

    def admissible(self, g: Array) -> Array:
        """The multiplier itself: every one is a gradient somewhere."""
        return g

    def conjugate(self, g: Array) -> float:
        """‖g‖²/4."""
        return float(g @ g) / 4.0

    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """Σ r²."""
        return cp.sum_squares(r)

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """Divided by 1 + step/2."""
        factor = 1.0 / (1.0 + 0.5 * step)
        return factor * v, Slope(np.full_like(v, factor))


@dataclass(frozen=True)
class Linear(Penalty):
    """Σ r; unbounded below, so constraints must bound its residuals."""

    formula = "Σ r"
    quadratic = True

    def value(self, r: Array) -> float:
        """Σ r."""
        return float(r.sum())

    def subgradient(self, r: Array) -> Array:
        """Ones."""
        return np.ones_like(r)

    def admissible(self, g: Array) -> Array:
        """Ones, the only gradient."""
        return np.ones_like(g)

    def conjugate(self, g: Array) -> float:
        """0 at the only gradient."""
        return 0.0

    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """Σ r."""
        return cp.sum(r)

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """Ones."""
        return np.ones_like(v), Slope(np.zeros_like(v))


@dataclass(frozen=True)
class _Norm(Penalty):
    """A sum of norms."""

    def conjugate(self, g: Array) -> float:
        """0 in the unit balls of the dual norms."""
        return 0.0

    def farthest(self, value: float) -> float:
        """Its own value, in one residual or group."""
        return value


@dataclass(frozen=True)
class Absolute(_Norm):
    """Σ |r|: few residuals differ from zero.

    Source: R. Tibshirani, Regression Shrinkage and Selection via the Lasso (1996).
    """

    formula = "Σ |r|"

    @property
    def split(self) -> Split:
        """Min Σ (above + below) over r = above − below."""
        return Split(1.0, squares_rest=False)

    def value(self, r: Array) -> float:
        """Σ |r|."""
        return float(np.abs(r).sum())

    def subgradient(self, r: Array) -> Array:
        """Signs, 0 where a residual is zero."""
        return np.sign(r)

    def admissible(self, g: Array) -> Array:
        """Between −1 and 1."""
        return np.clip(g, -1.0, 1.0)

    def gauge(self, g: Array) -> float:
        """The largest |g|."""
        return float(np.abs(g).max(initial=0.0))

    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """Σ |r|."""
        return cp.norm1(r)

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """The nearest point between −1 and 1."""
        return np.clip(v, -1.0, 1.0), Slope((np.abs(v) < 1.0).astype(float))


@dataclass(frozen=True)
class Groups(_Norm):
    """Σ ‖r_g‖ over groups of consecutive residuals: few groups differ from zero.

    Source: M. Yuan, Y. Lin, Model Selection and Estimation in Regression with Grouped
    Variables (2006).

    Attributes:
        size: Residuals per group [–].
    """

    size: int

    formula = "Σ ‖r_g‖ over groups of consecutive rows"

    @property
    def rows_per_group(self) -> int:
        """Residuals per group [–]."""
        return self.size

    def value(self, r: Array) -> float:
        """Σ ‖r_g‖."""
        return float(self._lengths(r).sum())

    def subgradient(self, r: Array) -> Array:
        """Unit vectors along each group, 0 where a group is zero."""
        lengths = np.repeat(self._lengths(r), self.size)
        return np.divide(r, lengths, out=np.zeros_like(r), where=lengths > 0.0)

    def admissible(self, g: Array) -> Array:
        """No group longer than 1."""
        lengths = np.repeat(self._lengths(g), self.size)
        return np.asarray(g / np.maximum(lengths, 1.0))

    def gauge(self, g: Array) -> float:
        """The longest group."""
        return float(self._lengths(g).max(initial=0.0))

    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """Σ ‖r_g‖."""
        groups = cp.reshape(r, (r.size // self.size, self.size), order="C")
        return cp.sum(cp.norm(groups, 2, axis=1))

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """The projection onto the unit balls; outside, its slope is tangential."""
        length = np.repeat(self._lengths(v), self.size)
        outside = length > 1.0
        longest = np.maximum(length, 1.0)
        g = v / longest
        return g, Slope(1.0 / longest, np.where(outside, g, 0.0), self.size)

    def _lengths(self, r: Array) -> Array:
        """Euclidean length of every group."""
        return np.asarray(np.linalg.norm(r.reshape(-1, self.size), axis=1))


@dataclass(frozen=True)
class Huber(Penalty):
    """Σ huber(r; δ): r² up to δ and 2δ|r| − δ² beyond.

    Source: P. J. Huber, Robust Estimation of a Location Parameter (1964).

    Attributes:
        threshold: δ, the largest squared residual [unit of r].
    """

    threshold: float

    formula = "Σ huber(r; δ)"
    smooth = True

    @property
    def split(self) -> Split:
        """Min ‖r − above + below‖² + 2δ Σ (above + below)."""
        return Split(2.0 * self.threshold, squares_rest=True)

    def value(self, r: Array) -> float:
        """Σ huber(r; δ)."""
        size = np.abs(r)
        small = np.minimum(size, self.threshold)
        return float((small * (2.0 * size - small)).sum())

    def subgradient(self, r: Array) -> Array:
        """Twice r, clipped to ±2δ."""
        return np.asarray(2.0 * np.clip(r, -self.threshold, self.threshold))

    def admissible(self, g: Array) -> Array:
        """Between −2δ and 2δ."""
        return np.clip(g, -2.0 * self.threshold, 2.0 * self.threshold)

    def conjugate(self, g: Array) -> float:
        """‖g‖²/4."""
        return float(g @ g) / 4.0

    def gauge(self, g: Array) -> float:
        """The largest |g| over 2δ."""
        return float(np.abs(g).max(initial=0.0)) / (2.0 * self.threshold)

    def farthest(self, value: float) -> float:
        """From Fenchel's inequality with 2δ r/‖r‖: φ(r) ≥ 2δ‖r‖ − δ²."""
        return 0.5 * (value / self.threshold + self.threshold)

    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """Σ huber(r; δ)."""
        return cp.sum(cp.huber(r, self.threshold))

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """Divided by 1 + step/2 and clipped to ±2δ."""
        factor, most = 1.0 / (1.0 + 0.5 * step), 2.0 * self.threshold
        g = factor * v
        return np.clip(g, -most, most), Slope(np.where(np.abs(g) < most, factor, 0.0))
