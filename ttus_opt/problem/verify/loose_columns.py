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

from dataclasses import dataclass, field

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
    members = program.limited_rows
    columns = [sp.csr_array(sp.csc_array(m.matrix)[:, loose]) for m in members]
    parts = [
        _Part(member, B, given[member.name])
        for member, B in zip(members, columns, strict=True)
        if B.nnz
    ]
    cost = np.zeros(int(loose.sum()))
    for term in program.terms:
        if term.weight and isinstance(term.penalty, Linear):
            cost += (term.weight * term.matrix.sum(axis=0))[loose]
    if not parts:
        return None if cost.any() else dict(given)
    B, y = sp.vstack([part.columns for part in parts]), [p.start for p in parts]
    size = np.concatenate([part.weights for part in parts])
    size = np.maximum(size, LEAST * (size.max() or 1.0))
    gram = sp.csc_array(B.T @ (size[:, None] * B))
    empty = sp.diags_array(np.where(gram.diagonal() > 0.0, 0.0, 1.0))
    try:
        inverse = splu(sp.csc_array(gram + empty))
    except RuntimeError:  # columns that depend on each other
        return None
    at = np.cumsum([0, *(len(part.start) for part in parts)])
    for _ in range(MOST):
        flat = np.concatenate(y)
        left = B.T @ flat + cost
        summands = abs(B).T @ np.abs(flat) + np.abs(cost)
        if (np.abs(left) <= ROUNDING * summands).all():
            names = (part.member.name for part in parts)
            return given | dict(zip(names, y, strict=True))
        flat = flat - size * (B @ inverse.solve(left))
        y = [
            part.member.admissible(flat[a:b])
            for part, a, b in zip(parts, at[:-1], at[1:], strict=True)
        ]
    return None


@dataclass(frozen=True)
class _Part:
    """Rows with entries in the columns.

    Attributes:
        member: Linear rows or cones.
        columns: B, shape (m, loose variables).
        start: Their multipliers, shape (m,).
    """

    member: ProgramConstraint | ProgramCones
    columns: sp.csr_array = field(repr=False)
    start: Array = field(repr=False)

    @property
    def weights(self) -> Array:
        """Sizes of the multipliers: of a whole cone, the same in all its rows, (m,)."""
        if isinstance(self.member, ProgramConstraint):
            return np.abs(self.start)
        sizes = np.diff([*self.member.first, len(self.start)])
        each = np.sqrt(np.add.reduceat(self.start**2, self.member.first))
        return np.repeat(each, sizes)
