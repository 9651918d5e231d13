"""A few unknowns beside the field, each with a column of the measured rows.

For fixed c the problem is that of the field alone with targets t - E c, and the best
field is linear in c. With y(c) = y_t - Y c its multipliers, what is left is

    minimise ½ cᵀS c - cᵀEᵀy_t,  S = EᵀY,  subject to the bounds of c,

one more dual solve per column, by directions that are largely kept from the first.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import lsq_linear

from ttus_opt.arrays import Array
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.solver import DualSolver

#: Most columns: each costs a dual solve
MOST = 64

#: Curvature of c below this part of the largest counts as none [–]
FLAT = 1e-12


@dataclass(frozen=True)
class ColumnsAnswer:
    """Field and coefficients.

    Attributes:
        p: The field, shape (V,).
        c: The coefficients, shape (k,).
        steps: New directions [–].
        late: Whether the deadline cut it short.
    """

    p: Array = field(repr=False)
    c: Array
    steps: int
    late: bool


def solve_with_columns(
    solver: DualSolver,
    data: DualData,
    lower: Array,
    upper: Array,
    *,
    rtol: float,
    deadline: float | None,
) -> ColumnsAnswer:
    """Best field and best coefficients within their bounds.

    Args:
        solver: Of the field alone.
        data: What it solves, with weighted columns E, shape (m, k).
        lower: Of c, shape (k,).
        upper: Of c, shape (k,).
        rtol: Relative residual of each dual solve [–].
        deadline: `time.perf_counter` at which to stop; None for never [s].
    """
    E, measure = data.columns, solver.system.measure
    first = solver.solve(data.b, data.t, rtol=rtol, deadline=deadline)
    steps, late = first.steps, first.late
    fields, Y = np.zeros((E.shape[1], len(data.b))), np.zeros_like(E)
    nothing = np.zeros_like(data.b)
    for k, column in enumerate(E.T):
        if late or not column.any():
            continue
        answer = solver.solve(nothing, column, rtol=rtol, deadline=deadline)
        fields[k], Y[:, k] = answer.p, column - measure(answer.p)
        steps, late = steps + answer.steps, late or answer.late
    c = _bounded(E.T @ Y, E.T @ (data.t - measure(first.p)), lower, upper)
    return ColumnsAnswer(first.p - c @ fields, c, steps, late)


def _bounded(S: Array, r: Array, lower: Array, upper: Array) -> Array:
    """Minimise ½ cᵀS c - rᵀc between bounds."""
    size, turn = np.linalg.eigh((S + S.T) / 2.0)
    curved = size > FLAT * max(size.max(initial=0.0), np.finfo(float).tiny)
    root = np.sqrt(size[curved])
    if not curved.any():
        return np.clip(np.zeros(len(r)), lower, upper)
    A, target = root[:, None] * turn[:, curved].T, turn[:, curved].T @ r / root
    return np.asarray(lsq_linear(A, target, (lower, upper), method="bvls", tol=1e-14).x)
