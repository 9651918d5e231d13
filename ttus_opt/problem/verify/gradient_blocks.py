"""The gradient of the Lagrangian relative to its summands, block by block.

A block is one variable of a program: the field, a parameter, a second field. Its
gradient is divided by the largest of the summands that should cancel in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.penalties.linear import Linear

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
