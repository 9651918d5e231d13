"""Members of a program: terms, rows, cones and bounds, with their names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.rows import scaled_rows
from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.problem.terms.penalties import Penalty, Squares
from ttus_opt.problem.terms.structure import (
    KnownCovariance,
    LaplaceRows,
    Tag,
    Tags,
    Whitened,
    declared,
)


@dataclass(frozen=True)
class ProgramTerm:
    """Rows of one term over all variables.

    Attributes:
        name: The term's name.
        weight: w [–].
        matrix: M, shape (m, n).
        target: t, shape (m,).
        penalty: φ.
        tags: Structure of the rows, see `ttus_opt.problem.terms.structure`.
    """

    name: str
    weight: float
    matrix: sp.csr_array = field(repr=False)
    target: Array = field(repr=False)
    penalty: Penalty = field(default_factory=Squares)
    tags: Tags = frozenset()

    @property
    def laplace_rows(self) -> LaplaceRows | None:
        """The tag of rows of L over a field; None without it."""
        return declared(self.tags, LaplaceRows)

    @property
    def known_covariance(self) -> KnownCovariance | None:
        """The tag of rows whose covariance is known; None without it."""
        return declared(self.tags, KnownCovariance)

    @property
    def whitening(self) -> sp.csr_array | None:
        """What measured wrenches were multiplied by, shape (3T, 3T); None for none."""
        tag = declared(self.tags, Whitened)
        return None if tag is None else tag.by

    @property
    def has_all_rows(self) -> bool:
        """Whether rows of L are there for fixed voxels too: their values are soft."""
        rows = self.laplace_rows
        return rows is not None and (
            rows.scale is None or len(self.target) == len(rows.scale)
        )

    @property
    def is_squares(self) -> bool:
        """Whether it is a sum of squares."""
        return isinstance(self.penalty, Squares)

    @property
    def is_measured(self) -> bool:
        """Whether its rows are declared to be measurements."""
        return Tag.MEASURED in self.tags

    def with_weight(self, weight: float) -> ProgramTerm:
        """The same rows with another weight."""
        return replace(self, weight=weight)

    def residual(self, x: Array) -> Array:
        """M x - t, shape (m,)."""
        return np.asarray(self.matrix @ x - self.target)

    def column_squares(self) -> Array:
        """Σ of the squares of every column's entries, shape (n,)."""
        M = self.matrix
        return np.asarray(np.bincount(M.indices, M.data**2, M.shape[1]), dtype=float)

    def cost(self, x: Array) -> float:
        """Weighted penalty w φ(M x - t)."""
        return self.weight * self.penalty.value(self.residual(x))


@dataclass(frozen=True)
class StackedTerms:
    """Rows of several terms, one below the other.

    Attributes:
        matrix: Rows without weights, shape (m, n).
        target: Targets likewise, shape (m,).
        root: Square roots of the weights, shape (m,) [–].
    """

    matrix: sp.csr_array = field(repr=False)
    target: Array = field(repr=False)
    root: Array = field(repr=False)

    @classmethod
    def of(
        cls, terms: Sequence[ProgramTerm], n: int, over: float = 1.0
    ) -> StackedTerms:
        """Stack the rows of terms, which may be none.

        Args:
            terms: The terms.
            n: Number of variables [–].
            over: What the weights are divided by [–].
        """
        roots = [np.full(len(t.target), np.sqrt(t.weight / over)) for t in terms]
        matrices, targets = [t.matrix for t in terms], [t.target for t in terms]
        return cls(
            sp.csr_array(sp.vstack([sp.csr_array((0, n)), *matrices], format="csr")),
            np.concatenate([np.zeros(0), *targets]),
            np.concatenate([np.zeros(0), *roots]),
        )

    @property
    def weighted(self) -> sp.csr_array:
        """Rows times their roots, shape (m, n)."""
        return scaled_rows(self.matrix, self.root)


def nonempty_columns(matrix: sp.csr_array) -> IntArray:
    """Columns with an entry, increasing."""
    used = np.zeros(matrix.shape[1], dtype=bool)
    used[matrix.indices] = True
    return np.flatnonzero(used).astype(np.int64)


def of_existing(dual: Array, lower: Array, upper: Array) -> Array:
    """Multipliers of limits that exist, positive at upper ones; zero for others."""
    return np.where(np.isfinite(np.where(dual > 0.0, upper, lower)), dual, 0.0)


def complementarity(dual: Array, lower: Array, upper: Array, value: Array) -> float:
    """Σ |dual| · distance of a value from the limit."""
    limit = np.where(dual > 0.0, upper, lower)
    limit = np.where(dual == 0.0, value, limit)
    return float(np.abs(dual * (limit - value)).sum())


@dataclass(frozen=True)
class Sides:
    """Rows lower ≤ A x ≤ upper as equalities and as inequalities from above.

    Attributes:
        lower: Shape (m,).
        upper: Shape (m,).
    """

    lower: Array = field(repr=False)
    upper: Array = field(repr=False)

    @cached_property
    def equal(self) -> Mask:
        """Which rows are equalities."""
        return np.asarray(self.lower == self.upper)

    @cached_property
    def above(self) -> Mask:
        """Which others have an upper limit."""
        return np.asarray(~self.equal & np.isfinite(self.upper))

    @cached_property
    def below(self) -> Mask:
        """Which others have a lower limit."""
        return np.asarray(~self.equal & np.isfinite(self.lower))

    def inequalities(self, A: sp.csr_array) -> tuple[sp.csr_array, Array]:
        """G and h of G x ≤ h: upper limits first, then lower ones negated."""
        limits = self.upper[self.above], -self.lower[self.below]
        return sp.csr_array(sp.vstack([A[self.above], -A[self.below]])), np.append(
            *limits
        )

    def multipliers(self, y: Array | None, z: Array | None) -> Array:
        """Multipliers of the rows, shape (m,), from those of equalities and of G x ≤ h.

        Args:
            y: Of the equalities; None, or empty, for none.
            z: Of G x ≤ h; likewise.
        """
        rows = np.zeros(len(self.equal))
        if y is not None and len(y):
            rows[self.equal] = y
        if z is not None and len(z):
            n_above = int(self.above.sum())
            rows[self.above] += np.asarray(z)[:n_above]
            rows[self.below] -= np.asarray(z)[n_above:]
        return rows


@dataclass(frozen=True)
class ProgramConstraint:
    """Rows lower ≤ A x ≤ upper of one constraint.

    Attributes:
        name: The constraint's name.
        matrix: A, shape (m, n).
        lower: Shape (m,).
        upper: Shape (m,).
        tags: Structure of the rows, see `ttus_opt.problem.terms.structure`.
    """

    name: str
    matrix: sp.csr_array = field(repr=False)
    lower: Array = field(repr=False)
    upper: Array = field(repr=False)
    tags: Tags = frozenset()

    @property
    def fixing(self) -> Mask:
        """Equality rows with a single entry, which fix a variable, shape (m,)."""
        single = np.diff(self.matrix.indptr) == 1
        return np.asarray(single & (self.lower == self.upper))

    def admissible(self, y: Array) -> Array:
        """Multipliers of limits that exist; zero for others."""
        return of_existing(y, self.lower, self.upper)

    def complementarity(self, y: Array, x: Array) -> float:
        """Σ |y| · distance of the rows from the limits of their multipliers."""
        return complementarity(y, self.lower, self.upper, self.matrix @ x)

    def slack(self, x: Array) -> Array:
        """Distance to the nearer limit, negative where violated, shape (m,)."""
        value = self.matrix @ x
        return np.asarray(np.minimum(value - self.lower, self.upper - value))


@dataclass(frozen=True)
class ProgramCones:
    """Rows s = A x + h of one constraint in second-order cones, s₀ ≥ ‖(s₁, …)‖ each.

    Attributes:
        name: The constraint's name.
        matrix: A, shape (m, n).
        offset: h, shape (m,).
        sizes: Rows of each cone, one after the other.
    """

    name: str
    matrix: sp.csr_array = field(repr=False)
    offset: Array = field(repr=False)
    sizes: tuple[int, ...] = field(repr=False)

    @cached_property
    def first(self) -> IntArray:
        """The first row of every cone."""
        return np.concatenate([[0], np.cumsum(self.sizes)[:-1]]).astype(np.int64)

    def value(self, x: Array) -> Array:
        """A x + h, shape (m,)."""
        return np.asarray(self.matrix @ x + self.offset)

    def slack(self, x: Array) -> Array:
        """s₀ − ‖(s₁, …)‖ of every cone, negative where violated."""
        s = self.value(x)
        return np.asarray(s[self.first] - self._lengths(s))

    def projected(self, s: Array) -> Array:
        """The nearest point of the cones, shape (m,).

        Source: N. Parikh, S. Boyd, Proximal Algorithms (2014), section 6.3.2.
        """
        head, length = s[self.first], self._lengths(s)
        inside, opposite = length <= head, length <= -head
        share = 0.5 * (1.0 + head / np.where(length > 0.0, length, 1.0))
        share = np.where(inside, 1.0, np.where(opposite, 0.0, share))
        out = np.repeat(share, self.sizes) * s
        out[self.first] = np.where(inside, head, share * length)
        return np.asarray(out)

    def admissible(self, y: Array) -> Array:
        """The nearest multiplier: minus a point of the cones, which are self-dual."""
        return -self.projected(-y)

    def complementarity(self, y: Array, x: Array) -> float:
        """|yᵀs|."""
        return abs(float(y @ self.value(x)))

    def _lengths(self, s: Array) -> Array:
        """‖(s₁, …)‖ of every cone."""
        tail = s**2
        tail[self.first] = 0.0
        return np.asarray(np.sqrt(np.add.reduceat(tail, self.first)))


@dataclass(frozen=True)
class ProgramBounds:
    """Bounds of one constraint on the variables themselves.

    Attributes:
        name: The constraint's name.
        lower: Shape (n,), -inf where there is none.
        upper: Shape (n,), +inf where there is none.
        part: The variable it bounds.
    """

    name: str
    lower: Array = field(repr=False)
    upper: Array = field(repr=False)
    part: slice = field(default_factory=lambda: slice(None))

    def slack(self, x: Array) -> Array:
        """Distance to the nearer limit, inf without one, shape of the part."""
        part = self.part
        below, above = x[part] - self.lower[part], self.upper[part] - x[part]
        return np.asarray(np.minimum(below, above))
