"""By how much a candidate violates the limits of a program."""

from __future__ import annotations

from collections.abc import Iterator

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
