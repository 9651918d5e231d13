"""Certificates of infeasibility and unboundedness, and which constraints conflict.

A solver's claim of either counts only with a certificate that holds for the program
(Boyd and Vandenberghe, Convex Optimization, section 5.8):

    infeasible  multipliers y, z with Aᵀy + z = 0 and Σ limit·multiplier < 0 (Farkas)
    unbounded   a ray d that changes no penalty but linear ones, stays within all
                limits, and along which the linear objective decreases

Sums that must vanish are judged by their own summands: whatever is left over would
decide the sign at a point far enough away. What is left of Aᵀy + z over a variable with
limits counts at the worst of them.

In the elastic problem all rows may be violated, at the cost of their violation:

    minimise Σ (s⁺ + s⁻)  over  lower ≤ A x + s⁺ − s⁻ ≤ upper,  lb ≤ x ≤ ub.

Its optimum is zero exactly when the constraints are consistent; otherwise its
multipliers are a certificate (Farkas) of the conflict, and name the constraints in it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.problem.members import ProgramBounds, Sides
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.penalties import Linear
from ttus_opt.problem.verify.kkt import Duals, bound_duals

#: A decrease below this part of its summands proves nothing [–]
ROUNDING = 1e-9

#: Sums below this part of their summands vanish but for rounding [–]
VANISHES = 16.0 * float(np.finfo(float).eps)


def contradicts(program: Program, duals: Duals) -> bool:
    """Whether multipliers prove that the constraints cannot hold together.

    Args:
        program: The program.
        duals: Multipliers, signs as in `ttus_opt.problem.verify.kkt`.
    """
    lower, upper = program.box
    z = duals.bounds
    parts = [] if z is None else [(z, lower, upper, z, np.abs(z))]
    for constraint in program.constraints:
        y = duals.rows.get(constraint.name)
        if y is not None:
            A, low, high = constraint.matrix, constraint.lower, constraint.upper
            parts.append((y, low, high, A.T @ y, abs(A).T @ np.abs(y)))
    left, sizes, products = np.zeros(len(lower)), np.zeros(len(lower)), [np.zeros(0)]
    for dual, low, high, image, size in parts:
        limit = np.where(dual > 0.0, high, low)
        products.append(dual[dual != 0.0] * limit[dual != 0.0])
        left, sizes = left + image, sizes + size
    # left · x is at most the sum of the products wherever all limits hold
    counts = np.abs(left) > VANISHES * sizes
    least = np.where(left > 0.0, lower, upper)[counts]
    products.append(-left[counts] * least)
    support = np.concatenate(products)
    if not np.isfinite(support).all():  # of an absent limit
        return False
    scale = float(np.abs(support).max(initial=0.0))
    return bool(sizes.any() and support.sum() < -ROUNDING * scale)


def decreases_forever(program: Program, ray: Array) -> bool:
    """Whether the objective is unbounded below along a feasible ray.

    Args:
        program: The program.
        ray: d, shape (n,).
    """
    size = float(np.abs(ray).max(initial=0.0))
    if not (np.isfinite(size) and size > 0.0):
        return False
    lower, upper = (np.isfinite(limit) for limit in program.box)
    d = ray / size
    out = (lower & (d < 0.0)) | (upper & (d > 0.0))
    if np.abs(d[out]).max(initial=0.0) > ROUNDING:
        return False
    d = np.where(out, 0.0, d)  # all else is judged without the rounding of bounds
    slope, scale = 0.0, 0.0
    for term in program.terms:
        change, least = term.matrix @ d, VANISHES * (abs(term.matrix) @ np.abs(d))
        if isinstance(term.penalty, Linear):
            slope += term.weight * float(change.sum())
            scale += abs(term.weight) * float(least.sum()) / VANISHES
        elif term.weight and (np.abs(change) > least).any():
            return False
    for cone in program.cones:
        s, least = cone.matrix @ d, VANISHES * (abs(cone.matrix) @ np.abs(d))
        if np.abs(s - cone.projected(s)).max(initial=0.0) > least.max(initial=0.0):
            return False
    for c in program.constraints:
        change, least = c.matrix @ d, VANISHES * (abs(c.matrix) @ np.abs(d))
        down, up = np.isfinite(c.lower), np.isfinite(c.upper)
        if (change < -least)[down].any() or (change > least)[up].any():
            return False
    return slope < -ROUNDING * scale


def falling_ray(program: Program, *, time_limit: float | None = None) -> Array | None:
    """A ray along which the objective is unbounded below; None if not found.

    Args:
        program: The program; penalties that are not linear count as growing along any
            ray that changes them.
        time_limit: For the linear program [s].

    Returns:
        d, shape (n,), verified by `decreases_forever`.
    """
    linear = [t for t in program.terms if isinstance(t.penalty, Linear) and t.weight]
    if not linear:  # sums of squares, lengths and sizes are never negative
        return None
    n = program.n_variables
    slope = np.sum(
        [t.weight * (t.matrix.T @ np.ones(len(t.target))) for t in linear], 0
    )
    still = [t.matrix for t in program.terms if not isinstance(t.penalty, Linear)]
    down = [sp.csr_array((0, n))]
    for c in program.constraints:
        down += [c.matrix[np.isfinite(c.upper)], -c.matrix[np.isfinite(c.lower)]]
    low, high = program.box
    box = np.where(np.isfinite(low), 0.0, -1.0), np.where(np.isfinite(high), 0.0, 1.0)
    above, equal = sp.vstack(down), sp.vstack([sp.csr_array((0, n)), *still])
    none, zero = np.zeros(above.shape[0]), np.zeros(equal.shape[0])
    rows = above, none, equal, zero
    answer = _linear_program(slope, *rows, box=box, time_limit=time_limit)
    if answer.x is None or not decreases_forever(program, answer.x):
        return None
    return np.asarray(answer.x)


def _linear_program(
    cost: Array, *rows: Any, box: tuple[Array, Array], time_limit: float | None
) -> Any:
    """SciPy's result, by HiGHS, of rows as of its ``linprog``."""
    from scipy.optimize import linprog

    options = {} if time_limit is None else {"time_limit": time_limit}
    bounds = np.stack(box, axis=1)
    return linprog(cost, *rows, bounds, options=options)  # type: ignore[call-overload]


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
    rows = *sides.inequalities(full), full[sides.equal], low[sides.equal]
    box = np.append(lower, np.zeros(2 * m)), np.append(upper, np.full(2 * m, np.inf))
    answer = _linear_program(cost, *rows, box=box, time_limit=time_limit)
    finite = np.concatenate([low[np.isfinite(low)], high[np.isfinite(high)], [0.0]])
    if answer.x is None or answer.fun <= FEASIBLE * max(np.abs(finite).max(), 1e-300):
        return ()
    y = sides.multipliers(answer.eqlin.marginals, answer.ineqlin.marginals)
    z = answer.lower.marginals[:n] + answer.upper.marginals[:n]
    # marginals are positive at lower limits, multipliers here negative
    y = np.where(np.abs(y) > NEGLIGIBLE, -y, 0.0)
    starts = np.cumsum([len(c.lower) for c in program.constraints])[:-1]
    split = zip(program.constraints, np.split(y, starts), strict=True)
    # bounds whose multipliers balance the rows exactly
    proof = Duals({c.name: part for c, part in split}, -(A.T @ y))
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
