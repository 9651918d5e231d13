"""The number of active limits of a solution, from its multipliers."""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.kkt import Duals

#: Threshold of a multiplier relative to the largest one, and of the largest one
#: relative to the objective's gradient, below which it is rounding [–]
NONZERO = 1e-6


def active_limits(program: Program, x: Array, duals: Duals) -> int:
    """Number of bounds and inequality rows with a nonzero multiplier [–].

    Interior-point methods leave a small multiplier at every limit, so that a few more
    may count.

    Args:
        program: The declared problem.
        x: A verified solution, shape (n,).
        duals: Its multipliers.
    """
    multipliers = [
        np.abs(duals.rows[member.name])[member.lower < member.upper]
        for member in program.constraints
        if member.name in duals.rows
    ]
    if program.bounds and duals.bounds is not None:
        lower, upper = program.box
        multipliers.append(np.abs(duals.bounds)[lower < upper])
    sizes = np.concatenate([*multipliers, np.zeros(0)])
    largest = float(sizes.max(initial=0.0))
    if largest <= NONZERO * _steepest(program, x):
        return 0
    return int(np.count_nonzero(sizes > NONZERO * largest))


def _steepest(program: Program, x: Array) -> float:
    """Largest entry among the summands of the objective's gradient."""
    return max(
        float(np.abs(part).max(initial=0.0)) for part in program.quadratic_gradient(x)
    )
