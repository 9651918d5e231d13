"""How far below an answer the optimum can lie, from what is left of the gradient.

With sums of squares ½ xᵀP x in the objective (P = 2 Σ w MᵀM) and multipliers of the
right sign, the Lagrangian is convex of curvature P at least, so that a dual residual
r bounds what is missing (weak duality, Boyd and Vandenberghe, Convex Optimization,
section 5.5.1):

    f(x) − f* ≤ complementarity + ½ rᵀP⁻¹r,      Σ w ‖M (x − x*)‖² ≤ f(x) − f*.

A relative residual alone tells neither: where the field is large and the weights of
the measurements are small, an answer that ignores all measurements has a small one.

rᵀP⁻¹r is found by conjugate gradients on P e = r, preconditioned by L⁻¹L⁻ᵀ on fields
and by the diagonal elsewhere. After k steps it lies between what the steps have
summed up and that plus ρ_k/θ, with ρ_k the residual in the preconditioner's norm and θ
the least eigenvalue of the preconditioned P (Golub and Strakoš, Numer. Algorithms 8,
1994): θ ≥ 1 where P contains the Laplace term that the preconditioner is made of, and
the least Ritz value of the steps elsewhere.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import eigvalsh_tridiagonal

from ttus_opt.errors import NumericalError
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.terms.base import Penalty

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Most steps; where they do not suffice nothing is told
MAX_STEPS = 80

#: The bound is close enough when it is this much above what is certain [–]
CLOSE = 0.1

#: Relative residual of the solves with L inside the preconditioner [–]
RTOL = 1e-6

#: A term is like L where it has this share of L's entries; fewer do not hold a field
#: as L does, and L⁻¹L⁻ᵀ would be no preconditioner [–]
ALIKE = 0.9

_TINY = np.finfo(float).tiny


def energy(
    program: Program, residual: Array, fixed: Mask, enough: float = 0.0
) -> float | None:
    """An upper bound of ½ rᵀP⁻¹r over the variables that are free to move.

    Args:
        program: Whose sums of squares make P.
        residual: r, the gradient of the Lagrangian, shape (n,).
        fixed: Variables that equalities hold, shape (n,).
        enough: A bound below this need not come closer.

    Returns:
        The bound; None where the squares do not determine the variables, or where
        that could not be told.
    """
    r = np.where(fixed, 0.0, residual)
    if not r.any():
        return 0.0
    squares = [t for t in program.terms if t.penalty is Penalty.SQUARES and t.weight]
    if not squares:
        return None
    preconditioner = _Preconditioner(program, squares, fixed)
    if r[preconditioner.untouched].any():  # no square holds these, r pulls at them
        return None
    try:
        return _bounded(squares, preconditioner, r, enough)
    except NumericalError:  # of the multigrid: what cannot be solved bounds nothing
        return None


def _bounded(
    squares: list[ProgramTerm], preconditioner: _Preconditioner, r: Array, enough: float
) -> float | None:
    """The conjugate gradients of the module's docstring."""
    if preconditioner.is_below:  # the first bound may do, at a tenth of the price
        bound = 0.5 * (1.0 + CLOSE) * preconditioner.square(r, CLOSE**2)
        if bound <= enough:
            return bound
    z = preconditioner.apply(r)
    rho, known, direction = float(r @ z), 0.0, z
    diagonal: list[float] = []
    beside: list[float] = []
    last_alpha, beta = 1.0, 0.0
    for step in range(MAX_STEPS):
        if not np.isfinite(rho) or rho < 0.0:
            return None
        least = _least(diagonal, beside, preconditioner.is_below)
        if least > 0.0:
            bound = 0.5 * (known + rho / least)
            if bound <= enough or rho / least <= CLOSE * known:
                return bound
        image = np.where(preconditioner.fixed, 0.0, _curved(squares, direction))
        curvature = float(direction @ image)
        if not curvature > 0.0:
            return None
        alpha = rho / curvature
        diagonal.append(1.0 / alpha + (beta / last_alpha if step else 0.0))
        known += alpha * rho
        r = r - alpha * image
        z = preconditioner.apply(r)
        before, rho = rho, float(r @ z)
        last_alpha, beta = alpha, max(rho, 0.0) / before
        beside.append(np.sqrt(beta) / alpha)
        direction = z + beta * direction
        if rho <= _TINY:
            return 0.5 * known
    return None


def _least(diagonal: list[float], beside: list[float], is_below: bool) -> float:
    """A least eigenvalue of the preconditioned P; 0 while nothing is known."""
    if is_below:
        return 1.0
    if len(diagonal) < 2:
        return 0.0
    ritz = eigvalsh_tridiagonal(
        np.array(diagonal), np.array(beside[:-1]), select="i", select_range=(0, 0)
    )
    return float(ritz[0])


def _curved(squares: list[ProgramTerm], x: Array) -> Array:
    """P x, shape (n,)."""
    total = np.zeros_like(x)
    for term in squares:
        total += 2.0 * term.weight * (term.matrix.T @ (term.matrix @ x))
    return total


class _Preconditioner:
    """About P⁻¹: (2w LᵀL)⁻¹ on fields that a term like L holds, else a diagonal.

    Attributes:
        fixed: Variables that do not move, shape (n,).
        untouched: Variables that no square touches, shape (n,).
        is_below: Whether P ⪰ its inverse for certain.
    """

    def __init__(
        self, program: Program, squares: list[ProgramTerm], fixed: Mask
    ) -> None:
        self.fixed = fixed
        self._laplace = program.laplace
        self._fields: list[tuple[slice, float, Mask]] = []
        self._diagonal = np.zeros(program.n_variables)
        rest = np.ones(program.n_variables, dtype=bool)
        for part in program.variables.values():
            weight = self._laplace_weight(squares, part)
            if weight > 0.0:
                self._fields.append((part, weight, fixed[part]))
                rest[part] = False
        self.is_below = not rest.any() and _holds_laplace(program)
        if rest.any():
            for term in squares:
                own = np.asarray(term.matrix.multiply(term.matrix).sum(axis=0))
                self._diagonal += 2.0 * term.weight * own.reshape(-1)
        self._diagonal[~rest] = 0.0
        self.untouched = rest & (self._diagonal == 0.0)

    def _laplace_weight(self, squares: list[ProgramTerm], part: slice) -> float:
        """Weight of the term that holds a variable as L does; 0 without one."""
        laplace, n = self._laplace, part.stop - part.start
        if laplace is None or len(laplace.free) != n:
            return 0.0
        for term in squares:
            indices = term.matrix.indices
            if term.matrix.nnz < ALIKE * laplace.L.nnz - n:
                continue
            within = np.count_nonzero((indices >= part.start) & (indices < part.stop))
            if within >= ALIKE * laplace.L.nnz - n:
                return term.weight
        return 0.0

    def square(self, r: Array, rtol: float) -> float:
        """A residual's square in the preconditioner's norm, fields only."""
        total = 0.0
        for part, weight, fixed in self._fields:
            u = self._laplace.solve_adjoint(r[part], rtol=rtol)
            total += float(u[~fixed] @ u[~fixed]) / (2.0 * weight)
        return total

    def apply(self, r: Array) -> Array:
        """Times a residual, shape (n,)."""
        positive = self._diagonal > 0.0
        out = np.where(positive, r / np.where(positive, self._diagonal, 1.0), 0.0)
        for part, weight, fixed in self._fields:
            u = self._laplace.solve_adjoint(r[part], rtol=RTOL)
            u[fixed] = 0.0  # identity rows: what is fixed has no share in L e
            out[part] = self._laplace.solve(u, rtol=RTOL) / (2.0 * weight)
        out[self.fixed] = 0.0
        return out


def _holds_laplace(program: Program) -> bool:
    """Whether the objective holds the squares of L p itself."""
    term = program.laplace_term
    if term is None or program.laplace is None or term.penalty is not Penalty.SQUARES:
        return False
    own, L = term.matrix, program.laplace.L
    if own is L:
        return True
    same = own.shape == L.shape and np.array_equal(own.indptr, L.indptr)
    same = same and np.array_equal(own.indices, L.indices)
    return bool(same and np.array_equal(own.data, L.data))


def held_by_equalities(program: Program) -> Mask:
    """Variables that an equality row of a single entry fixes, shape (n,)."""
    fixed = np.zeros(program.n_variables, dtype=bool)
    for constraint in program.constraints:
        matrix: sp.csr_array = constraint.matrix
        equal = constraint.lower == constraint.upper
        single = equal & (np.diff(matrix.indptr) == 1)
        fixed[matrix.indices[matrix.indptr[:-1][single]]] = True
    return fixed
