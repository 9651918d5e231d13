"""Multipliers for which the columns of variables without curvature vanish.

Auxiliary variables of a convex term, such as an upper limit of absolute values, have a
linear cost and rows, but no square that determines them. The Lagrangian is bounded
below only where its gradient over them is zero; a bound of the gap holds for any
multipliers y of which that is so and which are admissible. Those of a solver miss it by
the solver's accuracy. With B the columns and q the linear cost of these variables,

    min Σ (y′ − y)²/|y|   subject to   Bᵀy′ = −q ,

and a projection onto the signs and cones are repeated until both hold.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.problem.members import ProgramCones, ProgramConstraint
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.penalties import Linear

#: Most repetitions
MOST = 100

#: Gradients below this part of their summands vanish but for rounding [–]
ROUNDING = 16.0 * float(np.finfo(float).eps)

#: Least weight of a multiplier over the largest, for those that are zero [–]
LEAST = 1e-9


def loose_variables(program: Program, fixed: Mask) -> Mask:
    """Variables without limits that only linear terms and rows contain, shape (n,).

    Args:
        program: The program.
        fixed: Variables that equalities hold, shape (n,).
    """
    lower, upper = program.box
    loose = ~fixed & np.isinf(lower) & np.isinf(upper)
    for term in program.terms:
        if not term.weight or isinstance(term.penalty, Linear):
            continue
        if term.known_covariance:  # a regular matrix
            loose[: len(term.target)] = False
        elif loose.any():
            loose &= term.column_squares() == 0.0
    return np.asarray(loose)


def exact_rows(
    program: Program, given: dict[str, Array], loose: Mask
) -> dict[str, Array] | None:
    """Multipliers of rows and cones nearby for which these columns vanish.

    Args:
        program: The program.
        given: Multipliers by name, admissible.
        loose: Variables as from `loose_variables`, shape (n,).

    Returns:
        All multipliers; None where there are no such ones, or none were found.
    """
    every = program.limited_rows
    columns = [sp.csr_array(sp.csc_array(member.matrix)[:, loose]) for member in every]
    members = [m for m, B in zip(every, columns, strict=True) if B.nnz]
    cost = np.zeros(int(loose.sum()))
    for term in program.terms:
        if term.weight and isinstance(term.penalty, Linear):
            cost += (term.weight * term.matrix.sum(axis=0))[loose]
    if not members:
        return None if cost.any() else dict(given)
    B, y = sp.vstack([B for B in columns if B.nnz]), [given[m.name] for m in members]
    size = np.concatenate([_weights(*pair) for pair in zip(members, y, strict=True)])
    size = np.maximum(size, LEAST * (size.max() or 1.0))
    gram = sp.csc_array(B.T @ (size[:, None] * B))
    empty = sp.diags_array(np.where(gram.diagonal() > 0.0, 0.0, 1.0))
    try:
        inverse = splu(sp.csc_array(gram + empty))
    except RuntimeError:  # columns that depend on each other
        return None
    at = np.cumsum([len(part) for part in y])[:-1]
    for _ in range(MOST):
        flat = np.concatenate(y)
        left = B.T @ flat + cost
        summands = abs(B).T @ np.abs(flat) + np.abs(cost)
        if (np.abs(left) <= ROUNDING * summands).all():
            names = (member.name for member in members)
            return given | dict(zip(names, y, strict=True))
        flat = flat - size * (B @ inverse.solve(left))
        split = zip(members, np.split(flat, at), strict=True)
        y = [member.admissible(part) for member, part in split]
    return None


def _weights(member: ProgramConstraint | ProgramCones, y: Array) -> Array:
    """Sizes of the multipliers: of a whole cone, the same in all its rows, (m,)."""
    if isinstance(member, ProgramConstraint):
        return np.abs(y)
    each = np.sqrt(np.add.reduceat(y**2, member.first))
    return np.repeat(each, member.sizes)
