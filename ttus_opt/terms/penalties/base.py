"""What a penalty φ of a residual r is, and what optimality and solvers need of it.

Optimality needs a subgradient, the set of all subgradients (onto which a multiplier is
projected) and the conjugate φ*. For g in that set φ(r) + φ*(g) ≥ gᵀr, with equality
exactly where g is a subgradient at r (Fenchel; Rockafellar, Convex Analysis, section
23). Solvers need the penalty in cvxpy's words, for quadratic programs as a `Split`, or
for the method of multipliers its `resolvent`.

A new penalty is a class in a file of its own.
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass
from typing import Any, ClassVar

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError


@dataclass(frozen=True)
class Slope:
    """How multipliers g change with what they are made of: ∂g = factor (I − n nᵀ) ∂v.

    Attributes:
        factor: Per row, alike within a group, shape (m,) [–].
        along: A unit vector n per group, or zeros, shape (m,); None for zeros [–].
        size: Rows per group [–].
    """

    factor: Array
    along: Array | None = None
    size: int = 1

    def times(self, v: Array) -> Array:
        """The change of g that a change v makes, shape (m,)."""
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
        slope: Charge of each part [–].
        squares_rest: Whether the rest is charged by its squares; it is zero otherwise.
    """

    slope: float
    squares_rest: bool


@dataclass(frozen=True)
class Penalty(abc.ABC):
    """How a residual is charged; convex, and zero at zero unless it is linear."""

    #: The mathematics, for `repr`
    formula: ClassVar[str]
    #: Whether a quadratic program states it as it is
    quadratic: ClassVar[bool] = False
    #: Whether its gradient vanishes with the residual, as that of a square
    smooth: ClassVar[bool] = False

    @property
    def rows_per_group(self) -> int:
        """The number of residuals is a multiple of this [–]."""
        return 1

    @property
    def split(self) -> Split | None:
        """As a quadratic program; None where there is no such form."""
        return None

    @abc.abstractmethod
    def value(self, r: Array) -> float:
        """Evaluate φ(r).

        Args:
            r: Residuals, shape (m,).
        """

    @abc.abstractmethod
    def subgradient(self, r: Array) -> Array:
        """The subgradient of φ at r of least length, shape (m,)."""

    @abc.abstractmethod
    def admissible(self, g: Array) -> Array:
        """The nearest multiplier that is a subgradient of φ somewhere, shape (m,)."""

    @abc.abstractmethod
    def conjugate(self, g: Array) -> float:
        """Evaluate φ*(g) of an admissible multiplier."""

    def gauge(self, g: Array) -> float:
        """The least t ≥ 0 for which g is t times an admissible multiplier.

        With `farthest` it lets the verdict bound the gap where squares do not determine
        the answer (`ttus_opt.problem.absorption`), for penalties that are nowhere
        negative.

        Returns:
            t; infinite where the penalty does not state it.
        """
        return math.inf

    def farthest(self, value: float) -> float:
        """A bound of ‖r‖ over all r with φ(r) ≤ value; infinite where not stated."""
        return math.inf

    @abc.abstractmethod
    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """The penalty in cvxpy's words, for cone solvers.

        Args:
            r: A cvxpy expression of the residuals, shape (m,).
            cp: The module cvxpy, which this package loads only where it is used.

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
            g, shape (m,), and its slope, one of them where it has a kink.

        Raises:
            InputError: The penalty does not state it.
        """
        raise InputError(f"{type(self).__name__} does not state its resolvent")
