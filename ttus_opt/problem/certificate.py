"""Certificates of infeasibility and unboundedness.

A solver's claim of either counts only with a certificate that holds for the program
(Boyd and Vandenberghe, Convex Optimization, section 5.8):

    infeasible  multipliers y, z with Aᵀy + z = 0 and Σ limit·multiplier < 0 (Farkas)
    unbounded   a ray d that changes no penalty but linear ones, stays within all
                limits, and along which the linear objective decreases
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.problem.kkt import Duals
from ttus_opt.problem.program import Program
from ttus_opt.terms.penalties.linear import Linear

#: Sums below this part of their summands are zero up to rounding [–]
ROUNDING = 1e-9


def contradicts(program: Program, duals: Duals) -> bool:
    """Whether multipliers prove that the constraints cannot hold together.

    Args:
        program: The program.
        duals: Multipliers, signs as in `ttus_opt.problem.kkt`.
    """
    lower, upper = program.box
    z = duals.bounds
    parts = [] if z is None else [(z, lower, upper, z)]
    for constraint in program.constraints:
        y = duals.rows.get(constraint.name)
        if y is not None:
            image = constraint.matrix.T @ y
            parts.append((y, constraint.lower, constraint.upper, image))
    total, sizes, support, scale = np.zeros(program.n_variables), 0.0, 0.0, 0.0
    for dual, low, high, image in parts:
        limit = np.where(dual > 0.0, high, low)
        product = dual[dual != 0.0] * limit[dual != 0.0]
        if not np.isfinite(product).all():  # a multiplier of an absent limit
            return False
        total, sizes = total + image, max(sizes, float(np.abs(image).max(initial=0.0)))
        support += float(product.sum())
        scale = max(scale, float(np.abs(product).max(initial=0.0)))
    cancels = float(np.abs(total).max(initial=0.0)) <= ROUNDING * sizes
    return bool(cancels and sizes > 0.0 and support < -ROUNDING * scale)


def decreases_forever(program: Program, ray: Array) -> bool:
    """Whether the objective is unbounded below along a feasible ray.

    Args:
        program: The program.
        ray: d, shape (n,).
    """
    size = float(np.abs(ray).max(initial=0.0))
    if not (np.isfinite(size) and size > 0.0):
        return False
    d, slope = ray / size, 0.0
    for term in program.terms:
        change, reach = term.matrix @ d, _reach(term.matrix)
        if isinstance(term.penalty, Linear):
            slope += term.weight * float(change.sum())
        elif term.weight and np.abs(change).max(initial=0.0) > ROUNDING * reach:
            return False
    for cone in program.cones:
        s = cone.matrix @ d
        if np.abs(s - cone.projected(s)).max(initial=0.0) > ROUNDING:
            return False
    limits = [(c.matrix @ d, c.lower, c.upper) for c in program.constraints]
    limits.append((d, *program.box))
    for change, low, high in limits:
        below, above = change[np.isfinite(low)], change[np.isfinite(high)]
        if below.min(initial=0.0) < -ROUNDING or above.max(initial=0.0) > ROUNDING:
            return False
    return slope < -ROUNDING


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
    answer = linear_program(slope, (above, none), (equal, zero), box, time_limit)
    if answer.x is None or not decreases_forever(program, answer.x):
        return None
    return np.asarray(answer.x)


def linear_program(
    cost: Array,
    above: tuple[Any, Array],
    equal: tuple[Any, Array],
    box: tuple[Array, Array],
    time_limit: float | None,
) -> Any:
    """Minimise a linear cost by HiGHS.

    Args:
        cost: Shape (n,).
        above: Sparse rows, shape (m, n), and their upper limits, shape (m,).
        equal: Sparse rows and their values, likewise.
        box: Lower and upper bounds, shape (n,) each.
        time_limit: None for no limit [s].

    Returns:
        SciPy's result.
    """
    from scipy.optimize import linprog

    return linprog(  # type: ignore[call-overload]  # sparse rows are allowed
        cost,
        sp.csc_array(above[0]),
        above[1],
        sp.csc_array(equal[0]),
        equal[1],
        np.stack(box, axis=1),
        method="highs",
        options={} if time_limit is None else {"time_limit": time_limit},
    )


def _reach(matrix: sp.csr_array) -> float:
    """Largest entry, 1 where there is none."""
    return float(np.abs(matrix.data).max(initial=0.0)) or 1.0
