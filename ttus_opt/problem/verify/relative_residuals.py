"""Residuals relative to what they are made of: of the gradient, and of the limits.

The gradient of the Lagrangian is judged block by block. A block is one variable of a
program: the field, a parameter, a second field. Its gradient is divided by the largest
of the summands that should cancel in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.penalties import Linear

#: Generous relative rounding error of cancelling terms
ROUNDING = 1e-6

#: Rows whose lengths are computed at a time
CHUNK = 1 << 16

#: Prevents division by zero
TINY = float(np.finfo(float).tiny)


class GradientBlocks:
    """The gradient of the Lagrangian, and the norms of its summands by block."""

    def __init__(self, program: Program) -> None:
        self.gradient = np.zeros(program.n_variables)
        self._stray = np.zeros(program.n_variables)
        self._program = program
        self._sizes = dict.fromkeys(program.variables, 0.0)

    def add(self, summand: Array) -> None:
        """Add one of the summands that should cancel, shape (n,)."""
        self.gradient = self.gradient + summand
        self._measure(summand)

    def add_stray(self, summand: Array) -> None:
        """Add the image of multipliers of absent limits, which counts as an error."""
        if summand.any():
            self._stray = self._stray + summand
            self._measure(summand)

    @property
    def error(self) -> float:
        """Norm of the gradient and of the image of multipliers of absent limits."""
        return _length(self.gradient, self._stray)

    def _measure(self, summand: Array) -> None:
        for name, part in self._program.variables.items():
            size = float(np.linalg.norm(summand[part]))
            self._sizes[name] = largest_of(self._sizes[name], size)

    def worst(self, largest: float) -> float:
        """The largest block of the gradient over its largest summand [–]."""
        worst = 0.0
        for name, part in self._program.variables.items():
            size = _length(self.gradient[part], self._stray[part])
            if size == 0.0:
                continue
            least = _least_gradient(self._program, part, largest)
            scale = largest_of(self._sizes[name], least, TINY)
            worst = largest_of(worst, size / scale)
        return worst


def quadratic_summands(program: Program, x: Array) -> Iterator[Array]:
    """The summands of P x + q, one per variable, shape (n,) each.

    Contributions of two variables may cancel within P x, which would hide their size.
    """
    parts = list(program.variables.values())
    alone = np.zeros_like(x)
    for part in parts:
        alone[part] = x[part]
        yield program.curvature_times(alone)
        alone[part] = 0.0
    yield program.gradient_at_zero()


def _least_gradient(program: Program, part: slice, largest: float) -> float:
    """The least scale of a block's gradient, as residuals may vanish.

    For absolute values and lengths one row with its largest multiplier; for squares the
    rounding error of one row when the largest entry of x cancels.
    """
    least, whole = 0.0, len(program.variables) == 1
    for term in program.terms:
        if isinstance(term.penalty, Linear):
            continue
        longest = _longest_row(term.matrix if whole else term.matrix[:, part])
        row = term.weight * longest
        if term.penalty.smooth:
            row *= 2.0 * longest * largest * ROUNDING
        least = max(least, row)
    return least


def _length(*vectors: Array) -> float:
    """Euclidean norm of all of them together."""
    return math.hypot(*(float(np.linalg.norm(vector)) for vector in vectors))


def _longest_row(matrix: sp.csr_array) -> float:
    """Euclidean length of the longest row."""
    starts = matrix.indptr[:-1][np.diff(matrix.indptr) > 0]
    longest = 0.0
    for k in range(0, len(starts), CHUNK):  # avoids a copy of all entries
        chunk = starts[k : k + CHUNK]
        end = starts[k + CHUNK] if k + CHUNK < len(starts) else len(matrix.data)
        squares = matrix.data[chunk[0] : end] ** 2
        longest = max(longest, float(np.add.reduceat(squares, chunk - chunk[0]).max()))
    return math.sqrt(longest)


def largest_of(*values: float) -> float:
    """The largest value; infinite where one is NaN, unlike Python's ``max``."""
    return float("inf") if any(np.isnan(v) for v in values) else max(values)


#: Least scale of a member's values over the summands of its rows [–]
CANCELLED = 1e-3


def worst_violation(program: Program, x: Array) -> tuple[float, float]:
    """Largest violation of a bound, linear row or cone, as it is and relative.

    Args:
        program: The program.
        x: A candidate, shape (n,).

    Returns:
        The violation in the unit of its member, and over the member's largest finite
        limit or value, at least a thousandth of the summands of its rows [–].
    """
    largest = float(np.abs(x).max(initial=0.0))
    violation = relative = 0.0
    for value, lower, upper, size in _members(program, x):
        excess = np.maximum(lower - value, value - upper).max(initial=0.0)
        if excess == 0.0:
            continue
        sizes = np.abs([value, lower, upper])
        span = float(sizes[np.isfinite(sizes)].max(initial=0.0))
        # members whose values are zero up to rounding have a least scale
        scale = largest_of(span, size, ROUNDING * largest, TINY)
        violation = largest_of(violation, float(excess))
        relative = largest_of(relative, float(excess) / scale)
    return violation, relative


def _members(program: Program, x: Array) -> Iterator[tuple[Array, Array, Array, float]]:
    """Values of bounds, rows and cones between limits, and their least scale."""
    for b in program.bounds:
        yield x[b.part], b.lower[b.part], b.upper[b.part], 0.0
    for c in program.constraints:
        entries = np.abs(c.matrix.data * x[c.matrix.indices])
        size = CANCELLED * float(entries.max(initial=0.0))
        yield c.matrix @ x, c.lower, c.upper, size
    for cone in program.cones:  # with the projection onto the cones as limits
        s = cone.value(x)
        nearest = cone.projected(s)
        yield s, nearest, nearest, 0.0
