"""The constraints that contradict each other, by name.

In the elastic problem all rows may be violated, at the cost of their violation:

    minimise Σ (s⁺ + s⁻)  over  lower ≤ A x + s⁺ − s⁻ ≤ upper,  lb ≤ x ≤ ub.

Its optimum is zero exactly when the constraints are consistent; otherwise its
multipliers are a certificate (Farkas) of the conflict, and name the constraints in it.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.problem.members import ProgramBounds, Sides
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.certificate import contradicts, linear_program
from ttus_opt.problem.verify.kkt import Duals, bound_duals

#: Multipliers below this, of at most 1, are rounding
NEGLIGIBLE = 1e-6

#: Violations below this part of the largest limit are rounding
FEASIBLE = 1e-7


def conflicting(
    program: Program, *, claimed: Duals | None = None, time_limit: float | None = None
) -> tuple[str, ...]:
    """Names of the constraints that contradict each other.

    Args:
        program: The program; its objective is not used.
        claimed: A solver's certificate; without a valid one, the elastic problem is
            solved.
        time_limit: For the elastic problem [s].

    Returns:
        The names in the order of the program; empty without a proven conflict.
    """
    if claimed is not None and contradicts(program, claimed):
        return _named(program, claimed)
    lower, upper = program.box
    crossed = lower > upper
    if crossed.any():
        return tuple(b.name for b in program.bounds if _holds(b, crossed, program))
    if not program.constraints:
        return ()
    return _elastic(program, lower, upper, time_limit)


def _holds(bound: ProgramBounds, crossed: NDArray[np.bool_], program: Program) -> bool:
    """Whether one of the crossing limits belongs to a bound."""
    lower, upper = program.box
    low = np.isfinite(bound.lower) & (bound.lower == lower)
    high = np.isfinite(bound.upper) & (bound.upper == upper)
    return bool((crossed & (low | high)).any())


def _elastic(
    program: Program, lower: Array, upper: Array, time_limit: float | None
) -> tuple[str, ...]:
    A = sp.csr_array(sp.vstack([c.matrix for c in program.constraints]))
    low, high = program.limits
    m, n = A.shape
    unit = sp.eye_array(m, format="csr")
    full = sp.csr_array(sp.hstack([A, unit, -unit]))
    sides = Sides(low, high)
    cost = np.concatenate([np.zeros(n), np.ones(2 * m)])
    answer = linear_program(
        cost,
        sides.inequalities(full),
        (full[sides.equal], low[sides.equal]),
        (np.append(lower, np.zeros(2 * m)), np.append(upper, np.full(2 * m, np.inf))),
        time_limit,
    )
    finite = np.concatenate([low[np.isfinite(low)], high[np.isfinite(high)], [0.0]])
    if answer.x is None or answer.fun <= FEASIBLE * max(np.abs(finite).max(), 1e-300):
        return ()
    y = sides.multipliers(answer.eqlin.marginals, answer.ineqlin.marginals)
    z = answer.lower.marginals[:n] + answer.upper.marginals[:n]
    # marginals are positive at lower limits, multipliers here negative
    y = np.where(np.abs(y) > NEGLIGIBLE, -y, 0.0)
    starts = np.cumsum([len(c.lower) for c in program.constraints])[:-1]
    rows = zip(program.constraints, np.split(y, starts), strict=True)
    # bounds whose multipliers balance the rows exactly
    proof = Duals({c.name: part for c, part in rows}, -(A.T @ y))
    z = np.where(np.abs(z) > NEGLIGIBLE, -z, 0.0)
    if not contradicts(program, proof):
        proof = Duals(proof.rows, z)
    return _named(program, proof) if contradicts(program, proof) else ()


def _named(program: Program, proof: Duals) -> tuple[str, ...]:
    """The constraints and bounds that carry a multiplier, in the program's order."""
    counting = {name for name, y in proof.rows.items() if _counts(y)}
    if proof.bounds is not None:
        split = bound_duals(program, proof.bounds)
        counting |= {name for name, dual in split.items() if _counts(dual)}
    names = [member.name for member in program.constraints]
    names += [member.name for member in program.bounds]
    return tuple(name for name in names if name in counting)


def _counts(dual: Array) -> bool:
    return bool(np.abs(dual).max(initial=0.0) > NEGLIGIBLE)
