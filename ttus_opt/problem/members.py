"""Members of a program: terms, rows and bounds, each still knowing its name.

A term's penalty φ comes with what optimality needs of it: a subgradient, the set of
all subgradients (to which a multiplier is brought back) and the conjugate φ*. For
g in that set φ(r) + φ*(g) ≥ gᵀr, with equality exactly where g belongs to r.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.terms.base import Penalty

#: Penalties a quadratic program states as they are
QUADRATIC = (Penalty.SQUARES, Penalty.LINEAR)

#: Penalties a quadratic program states with auxiliary variables
LIFTABLE = (Penalty.HUBER, Penalty.ABSOLUTE)


@dataclass(frozen=True)
class ProgramTerm:
    """Rows of one term over all variables.

    Attributes:
        name: The term's name.
        weight: w [–].
        matrix: M, shape (m, n).
        target: t, shape (m,).
        penalty: φ.
        threshold: Huber's δ.
        group_size: Rows per group of a group norm; they are consecutive.
        laplace_scale: Where M is the free rows of the scene's L, each times a number
            of its own: those numbers, shape (V,); None otherwise.
    """

    name: str
    weight: float
    matrix: sp.csr_array = field(repr=False)
    target: Array = field(repr=False)
    penalty: Penalty = Penalty.SQUARES
    threshold: float = np.inf
    group_size: int = 1
    laplace_scale: Array | None = field(default=None, repr=False)

    def with_weight(self, weight: float) -> ProgramTerm:
        """The same rows with another weight."""
        return replace(self, weight=weight)

    def residual(self, x: Array) -> Array:
        """M x - t, shape (m,)."""
        return np.asarray(self.matrix @ x - self.target)

    def cost(self, x: Array) -> float:
        """Weighted penalty w φ(M x - t)."""
        return self.weight * self.value(self.residual(x))

    def value(self, r: Array) -> float:
        """Penalty φ(r) without the weight."""
        if self.penalty is Penalty.SQUARES:
            return float(r @ r)
        if self.penalty is Penalty.LINEAR:
            return float(r.sum())
        if self.penalty is Penalty.GROUPS:
            return float(self._lengths(r).sum())
        size = np.abs(r)
        if self.penalty is Penalty.ABSOLUTE:
            return float(size.sum())
        small = np.minimum(size, self.threshold)
        return float((small * (2.0 * size - small)).sum())

    def subgradient(self, r: Array) -> Array:
        """A subgradient of φ at r, the one of least length, shape (m,)."""
        if self.penalty is Penalty.SQUARES:
            return 2.0 * r
        if self.penalty is Penalty.LINEAR:
            return np.ones_like(r)
        if self.penalty is Penalty.HUBER:
            return np.asarray(2.0 * np.clip(r, -self.threshold, self.threshold))
        if self.penalty is Penalty.ABSOLUTE:
            return np.sign(r)
        lengths = np.repeat(self._lengths(r), self.group_size)
        return np.divide(r, lengths, out=np.zeros_like(r), where=lengths > 0.0)

    def admissible(self, g: Array) -> Array:
        """The nearest multiplier that is a subgradient of φ somewhere, shape (m,)."""
        if self.penalty is Penalty.SQUARES:
            return g
        if self.penalty is Penalty.LINEAR:
            return np.ones_like(g)
        if self.penalty is Penalty.HUBER:
            return np.clip(g, -2.0 * self.threshold, 2.0 * self.threshold)
        if self.penalty is Penalty.ABSOLUTE:
            return np.clip(g, -1.0, 1.0)
        lengths = np.repeat(self._lengths(g), self.group_size)
        return np.asarray(g / np.maximum(lengths, 1.0))

    def conjugate(self, g: Array) -> float:
        """φ*(g) of an admissible multiplier."""
        if self.penalty in (Penalty.SQUARES, Penalty.HUBER):
            return float(g @ g) / 4.0
        return 0.0

    def _lengths(self, r: Array) -> Array:
        """Euclidean length of every group."""
        return np.asarray(np.linalg.norm(r.reshape(-1, self.group_size), axis=1))


@dataclass(frozen=True)
class ProgramConstraint:
    """Rows lower ≤ A x ≤ upper of one constraint.

    Attributes:
        name: The constraint's name.
        matrix: A, shape (m, n).
        lower: Shape (m,).
        upper: Shape (m,).
    """

    name: str
    matrix: sp.csr_array = field(repr=False)
    lower: Array = field(repr=False)
    upper: Array = field(repr=False)

    def slack(self, x: Array) -> Array:
        """Distance to the nearer limit, negative where it is broken, shape (m,)."""
        value = self.matrix @ x
        return np.asarray(np.minimum(value - self.lower, self.upper - value))


@dataclass(frozen=True)
class ProgramBounds:
    """Bounds of one constraint on the variables themselves.

    Attributes:
        name: The constraint's name.
        lower: Shape (n,), -inf where there is none.
        upper: Shape (n,), +inf where there is none.
        part: Which part of x it speaks of.
    """

    name: str
    lower: Array = field(repr=False)
    upper: Array = field(repr=False)
    part: slice = field(default_factory=lambda: slice(None))

    def slack(self, x: Array) -> Array:
        """Distance to the nearer limit, inf where there is none, shape of the part."""
        part = self.part
        below, above = x[part] - self.lower[part], self.upper[part] - x[part]
        return np.asarray(np.minimum(below, above))
