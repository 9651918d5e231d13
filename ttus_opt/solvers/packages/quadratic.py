"""A quadratic program in the forms of solver packages, and its solution read back.

Two shapes of the sparse least-squares form (`Program.least_squares_qp`), which keeps
L and N apart and always has equality rows:

    `OneSided`  G x ≤ h, A x = b, lb ≤ x ≤ ub      most packages
    `TwoSided`  l ≤ A x ≤ u, bounds as rows        splitting methods

Signs of all duals: stationarity is P x + q + Aᵀy + z = 0, positive at an upper limit.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.problem.members import Sides
from ttus_opt.problem.program import Program, QuadraticForm
from ttus_opt.problem.verify.kkt import Duals
from ttus_opt.solvers.base import Candidate, Claim


@dataclass(frozen=True)
class OneSided:
    """Inequalities from above, equalities and a box.

    Attributes:
        P: Symmetric, shape (n, n).
        q: Shape (n,).
        G: Inequality rows, shape (k, n): upper limits first, then lower ones negated.
        h: Shape (k,).
        A: Equality rows, shape (m, n).
        b: Shape (m,).
        lb: Shape (n,).
        ub: Shape (n,).
        sides: Which rows of the form became what.
    """

    P: sp.csc_matrix = field(repr=False)
    q: Array = field(repr=False)
    G: sp.csc_matrix = field(repr=False)
    h: Array = field(repr=False)
    A: sp.csc_matrix = field(repr=False)
    b: Array = field(repr=False)
    lb: Array = field(repr=False)
    ub: Array = field(repr=False)
    sides: Sides = field(repr=False)

    @classmethod
    def of(cls, form: QuadraticForm) -> OneSided:
        """Split two-sided rows; the box stays one."""
        sides, A = Sides(form.lower, form.upper), sp.csr_array(form.A)
        G, h = sides.inequalities(A)
        return cls(
            sp.csc_matrix(form.P),
            form.q,
            sp.csc_matrix(G),
            h,
            sp.csc_matrix(A[sides.equal]),
            form.lower[sides.equal],
            form.lb,
            form.ub,
            sides,
        )

    @property
    def boxed(self) -> bool:
        """Whether any variable has a bound."""
        return bool(np.isfinite(self.lb).any() or np.isfinite(self.ub).any())


@dataclass(frozen=True)
class TwoSided:
    """Rows between limits; each bounded variable has a row of its own at the end.

    Attributes:
        P: Symmetric, shape (n, n).
        q: Shape (n,).
        A: Shape (m + k, n).
        lower: Shape (m + k,).
        upper: Shape (m + k,).
        n_rows: m, how many of the rows come from the form.
        bounded: Which variables have a bound, k in all, shape (n,).
    """

    P: sp.csc_matrix = field(repr=False)
    q: Array = field(repr=False)
    A: sp.csc_matrix = field(repr=False)
    lower: Array = field(repr=False)
    upper: Array = field(repr=False)
    n_rows: int
    bounded: Mask = field(repr=False)

    @classmethod
    def of(cls, form: QuadraticForm) -> TwoSided:
        """Append the bounds as rows."""
        bounded = np.isfinite(form.lb) | np.isfinite(form.ub)
        picked = np.flatnonzero(bounded)
        n, k = len(form.q), len(picked)
        unit = sp.csc_array((np.ones(k), (np.arange(k), picked)), shape=(k, n))
        return cls(
            sp.csc_matrix(form.P),
            form.q,
            sp.csc_matrix(sp.vstack([form.A, unit])),
            np.concatenate([form.lower, form.lb[bounded]]),
            np.concatenate([form.upper, form.ub[bounded]]),
            len(form.lower),
            bounded,
        )

    @property
    def form(self) -> QuadraticForm:
        """The same without a box."""
        free = np.full(len(self.q), np.inf)
        P, A = sp.csc_array(self.P), sp.csc_array(self.A)
        return QuadraticForm(P, self.q, A, self.lower, self.upper, -free, free)

    def split(self, y: Array) -> tuple[Array, Array]:
        """Multipliers of the form's rows, and of the bounds at full length."""
        box = np.zeros(len(self.q))
        box[self.bounded] = y[self.n_rows :]
        return np.asarray(y[: self.n_rows]), box

    def same_structure(self, other: TwoSided) -> bool:
        """Whether patterns, equalities and finite limits are the same."""
        return (
            _same_pattern(self.P, other.P)
            and _same_pattern(self.A, other.A)
            and np.array_equal(self.bounded, other.bounded)
            and np.array_equal(self.lower == self.upper, other.lower == other.upper)
            and np.array_equal(np.isfinite(self.lower), np.isfinite(other.lower))
            and np.array_equal(np.isfinite(self.upper), np.isfinite(other.upper))
        )


def _same_pattern(one: sp.csc_matrix, other: sp.csc_matrix) -> bool:
    return bool(
        one.shape == other.shape
        and np.array_equal(one.indptr, other.indptr)
        and np.array_equal(one.indices, other.indices)
    )


def read_back(
    program: Program,
    form: QuadraticForm,
    x: Array | None,
    row_duals: Array,
    box_duals: Array | None,
    *,
    iterations: int = 0,
    claim: Claim = Claim.DONE,
    detail: str = "",
) -> Candidate:
    """A candidate of the program from a solution of its form.

    Args:
        program: The program.
        form: Its least-squares or explicit form.
        x: The form's variables; None, or not finite, for no solution.
        row_duals: Multipliers of the form's rows.
        box_duals: Multipliers of the form's bounds; None without bounds.
        iterations: As in `Candidate`.
        claim: As in `Candidate`.
        detail: As in `Candidate`.
    """
    if x is None or not np.isfinite(x).all():
        # several packages return huge numbers or NaN when they fail
        failed = Claim.GAVE_UP if claim is Claim.DONE else claim
        return Candidate(None, iterations=iterations, claim=failed, detail=detail)
    n = program.n_variables
    rows, at = {}, form.n_lifted
    for constraint in program.constraints:
        size = len(constraint.lower)
        rows[constraint.name] = np.array(row_duals[at : at + size])
        at += size
    bounds = None
    if program.bounds and box_duals is not None and len(box_duals):
        bounds = np.array(box_duals[:n])
    return Candidate(np.array(x[:n]), Duals(rows, bounds), iterations, claim, detail)
