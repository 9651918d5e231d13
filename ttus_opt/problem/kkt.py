"""Optimality of an answer, computed here and never taken from a solver.

For minimise ½xᵀPx + qᵀx subject to lower ≤ A x ≤ upper and lb ≤ x ≤ ub the duals y
(rows) and z (bounds) are positive where an upper limit holds x back, negative at a
lower limit:

    primal  how far A x and x lie outside their limits
    dual    P x + q + Aᵀy + z = 0
    gap     xᵀPx + qᵀx + Σ limit·dual = 0

A penalty φ that is no sum of squares has a multiplier g of its residual r, brought
back into the set of φ's subgradients; it adds w Mᵀg to the dual residual and
w (φ(r) + φ*(g) + gᵀt) to the gap, which vanish together exactly where g is a
subgradient of φ at r. For squares g = 2r and both are the lines above.

Norms: primal in the largest entry, dual in the Euclidean norm; each relative figure
is divided by the largest of the quantities that should cancel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.problem.members import QUADRATIC
from ttus_opt.problem.program import Program
from ttus_opt.terms.base import Penalty

Array = NDArray[np.float64]

_TINY = np.finfo(float).tiny

#: What cancelling leaves of a sum of squares, generously
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Duals:
    """Multipliers by constraint name, signs as in the module's docstring.

    Attributes:
        rows: y per linear constraint, shape (m,) each.
        bounds: z of the box, shape (n,); None where nothing is bounded.
        terms: g per term whose penalty is neither squares nor linear, shape (m,)
            each; the subgradient of least length where it is missing.
    """

    rows: Mapping[str, Array] = field(default_factory=dict)
    bounds: Array | None = None
    terms: Mapping[str, Array] = field(default_factory=dict)


def bound_duals(program: Program, bounds: Array | None) -> dict[str, Array]:
    """Split the box's multipliers by the name of the bound that holds x back.

    Args:
        program: Whose bounds they are.
        bounds: z, shape (n,); None counts as zero.

    Returns:
        Per named bound the multipliers of its variable, shape of the variable.
    """
    z = np.zeros(program.n_variables) if bounds is None else bounds
    lower, upper = program.box
    above, below = np.maximum(z, 0.0), np.minimum(z, 0.0)
    found = {}
    for bound in program.bounds:
        # the tightest limit carries the multiplier; of equals the first takes it
        holds = bound.upper == upper
        reaches = bound.lower == lower
        found[bound.name] = (above * holds + below * reaches)[bound.part]
        above, below = above * ~holds, below * ~reaches
    return found


@dataclass(frozen=True)
class KKT:
    """Residuals of the optimality conditions.

    Attributes:
        primal: Largest violation of a limit [the limit's unit].
        dual: Norm of the Lagrangian's gradient.
        gap: Difference of primal and dual objective.
        primal_relative: ``primal`` over the largest finite limit or row value [–].
        dual_relative: ``dual`` over the largest of its summands [–].
        gap_relative: ``gap`` over the larger objective [–].
    """

    primal: float
    dual: float
    gap: float
    primal_relative: float
    dual_relative: float
    gap_relative: float

    @property
    def worst_relative(self) -> float:
        """The largest relative residual [–]."""
        return max(self.primal_relative, self.dual_relative, self.gap_relative)

    def as_dict(self) -> dict[str, float]:
        """All residuals by name, for JSON."""
        return asdict(self)


def kkt_residuals(program: Program, x: Array, duals: Duals) -> KKT:
    """Residuals of the optimality conditions of a program.

    Args:
        program: The program.
        x: A candidate, shape (n,).
        duals: Its multipliers; missing ones count as zero.

    Returns:
        The residuals; infinite when the candidate is not finite.
    """
    if not np.isfinite(x).all():
        return KKT(*([float("inf")] * 6))
    curved, linear = program.quadratic_gradient(x)
    gradient = curved + linear
    sizes = [float(np.linalg.norm(curved)), float(np.linalg.norm(linear))]
    quadratic = float(curved @ x)
    slope = float(linear @ x)
    largest = float(np.abs(x).max(initial=0.0))
    least = _least_pull(program, largest)
    sizes.append(least)
    for term in program.terms:
        if term.penalty in QUADRATIC:
            continue
        r = term.residual(x)
        g = term.admissible(duals.terms.get(term.name, term.subgradient(r)))
        pull = term.weight * (term.matrix.T @ g)
        gradient = gradient + pull
        sizes.append(float(np.linalg.norm(pull)))
        quadratic += term.weight * (term.value(r) + term.conjugate(g))
        slope += term.weight * float(g @ term.target)
    support, violation, span = 0.0, 0.0, 0.0
    for constraint in program.constraints:
        y = duals.rows.get(constraint.name, np.zeros(len(constraint.lower)))
        value = constraint.matrix @ x
        pull = constraint.matrix.T @ y
        gradient = gradient + pull
        sizes.append(float(np.linalg.norm(pull)))
        support += _support(y, constraint.lower, constraint.upper, value)
        violation = max(
            violation, _violation(value, constraint.lower, constraint.upper)
        )
        span = max(span, _largest(value, constraint.lower, constraint.upper))
    if program.bounds:
        lower, upper = program.box
        z = np.zeros_like(x) if duals.bounds is None else duals.bounds
        gradient = gradient + z
        sizes.append(float(np.linalg.norm(z)))
        support += _support(z, lower, upper, x)
        violation = max(violation, _violation(x, lower, upper))
        span = max(span, _largest(x, lower, upper))
    dual = float(np.linalg.norm(gradient))
    gap = abs(quadratic + slope + support)
    scale = max(abs(quadratic), abs(slope), abs(support), least * largest, _TINY)
    return KKT(
        violation,
        dual,
        gap,
        violation / max(span, _TINY),
        dual / max(*sizes, _TINY),
        gap / scale,
    )


def _support(dual: Array, lower: Array, upper: Array, value: Array) -> float:
    """Σ limit·dual; a multiplier of an absent limit is charged its own size."""
    limit = np.where(dual > 0.0, upper, lower)
    absent = ~np.isfinite(limit)
    # pulling at a limit that is not there is an error of the dual, not of the gap
    charged = np.where(absent, np.abs(value) + 1.0, limit)
    product = np.where(absent, np.abs(dual) * charged, dual * charged)
    return float(product.sum())


def _least_pull(program: Program, largest: float) -> float:
    """The least size of a gradient that counts, where all residuals may vanish.

    For absolute values and lengths one row at its limit; for squares what rounding
    leaves of one row when the largest entry of x cancels.
    """
    least = 0.0
    for term in program.terms:
        if term.penalty is Penalty.LINEAR:
            continue
        longest = _longest_row(term.matrix)
        row = term.weight * longest
        if term.penalty in (Penalty.SQUARES, Penalty.HUBER):
            row *= 2.0 * longest * largest * _ROUNDING
        least = max(least, row)
    return least


def _longest_row(matrix: sp.csr_array) -> float:
    """Euclidean length of the longest row."""
    starts = matrix.indptr[:-1][np.diff(matrix.indptr) > 0]
    if not len(starts):
        return 0.0
    return float(np.sqrt(np.add.reduceat(matrix.data**2, starts).max()))


def _violation(value: Array, lower: Array, upper: Array) -> float:
    if not len(value):
        return 0.0
    return float(max(np.max(lower - value), np.max(value - upper), 0.0))


def _largest(*arrays: Array) -> float:
    largest = 0.0
    for array in arrays:
        finite = array[np.isfinite(array)]
        if len(finite):
            largest = max(largest, float(np.abs(finite).max()))
    return largest
