"""Base class of penalties φ of a residual r.

The optimality conditions use a subgradient, the projection onto the set of all
subgradients, and the conjugate φ*: for g in that set φ(r) + φ*(g) ≥ gᵀr, with equality
exactly where g is a subgradient at r (Fenchel; Rockafellar, Convex Analysis, section
23). Solvers use a cvxpy expression, a `Split` for quadratic programs, or the
`resolvent` for the method of multipliers.

A new penalty is a class in a file of its own.
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass
from typing import Any, ClassVar

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError


@dataclass(frozen=True)
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
