"""By how much a candidate violates the limits of a program."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.gradient_blocks import ROUNDING, TINY, largest_of

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
    for member in _members(program, x):
        violation = largest_of(violation, member.violation)
        relative = largest_of(relative, member.relative(ROUNDING * largest))
    return violation, relative


def _members(program: Program, x: Array) -> Iterator[_Member]:
    """Bounds, rows and cones at x."""
    for b in program.bounds:
        yield _Member(x[b.part], b.lower[b.part], b.upper[b.part])
    for c in program.constraints:
        entries = np.abs(c.matrix.data * x[c.matrix.indices])
        size = CANCELLED * float(entries.max(initial=0.0))
        yield _Member(c.matrix @ x, c.lower, c.upper, size)
    for cone in program.cones:  # with the projection onto the cones as limits
        s = cone.value(x)
        nearest = cone.projected(s)
        yield _Member(s, nearest, nearest)


@dataclass(frozen=True)
class _Member:
    """Values of one constraint or bound between its limits."""

    value: Array
    lower: Array
    upper: Array
    least: float = 0.0  # least scale, from the summands of the rows

    @property
    def violation(self) -> float:
        """Largest excess over a limit."""
        if not len(self.value):
            return 0.0
        below, above = self.lower - self.value, self.value - self.upper
        return largest_of(float(np.max(below)), float(np.max(above)), 0.0)

    def relative(self, least: float) -> float:
        """The same over the largest finite limit or value [–].

        Args:
            least: Least scale, for members whose values are zero up to rounding.
        """
        violation = self.violation
        if not violation:
            return 0.0
        sizes = np.abs([self.value, self.lower, self.upper])
        span = float(sizes[np.isfinite(sizes)].max(initial=0.0))
        return violation / largest_of(span, self.least, least, TINY)
