"""Bound of the gap from the dual residual, for sums of squares.

With sums of squares ½ xᵀP x in the objective (P = 2 Σ w MᵀM) and multipliers of the
right sign, the Hessian of the Lagrangian is at least P, so that a dual residual r
bounds the gap (weak duality, Boyd and Vandenberghe, Convex Optimization, section
5.5.1):

    f(x) − f* ≤ complementarity + ½ rᵀP⁻¹r,      Σ w ‖M (x − x*)‖² ≤ f(x) − f*.

A relative residual implies neither: where the field is large and the weights of the
measurements are small, an answer that ignores all measurements has a small residual.

The inverse of the Laplace terms' part A of P is known, A⁻¹ = L⁻¹Ω L⁻ᵀ/2w, as is that of
a term whose covariance is known. With the other rows R:

- fields only: P = A + RᵀR ⪰ A, so that rᵀA⁻¹r is a bound. Conjugate gradients
  preconditioned by A tighten it: rᵀP⁻¹r lies between their accumulated sum and that
  plus the squared residual in A⁻¹ (Golub and Strakoš, Numer. Algorithms 8, 1994).
- fields and parameters c with columns E of R: eliminating the fields from half of A
  gives P ⪰ ½A ⊕ Eᵀ(I + 2K)⁻¹E ⪰ ½A ⊕ EᵀE/(1 + 2κ), K = R A⁻¹Rᵀ, with κ a generous
  estimate of its largest eigenvalue by the power method. A parameter within a Laplace
  term, L q + C c, is first eliminated: q′ = q + L⁻¹C c.
- otherwise (a user's prior, another operator): conjugate gradients to a small residual;
  no bound where they do not converge.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import NumericalError
from ttus_opt.gaussian.prior import LaplacePrior, Prior
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.members import ProgramTerm, StackedTerms
from ttus_opt.problem.program import Program

_Map = Callable[[Array], Array]

#: Most steps of conjugate gradients
MAX_STEPS = 80

#: Largest relative excess of a bound over the lower estimate [–]
CLOSE = 0.1

#: Squared relative residual to which conjugate gradients solve without a bound [–]
NOTHING = 1e-12

#: Relative residual of the solves with L inside the preconditioner [–]
RTOL = 1e-6

#: Most parameters beside the fields
MOST = 64

#: Steps of the power method, accuracy of its solves, and factor on its result [–]
POWER, ROUGHLY, GENEROUS = 3, 1e-2, 3.0

_TINY = np.finfo(float).tiny


def energy(
    program: Program, residual: Array, fixed: Mask, enough: float = 0.0
) -> float | None:
    """An upper bound of ½ rᵀP⁻¹r over the free variables.

    Args:
        program: The program.
        residual: r, the gradient of the Lagrangian, shape (n,).
        fixed: Variables that equalities hold, or whose gradient vanishes, shape (n,).
        enough: A bound below this is not tightened.

    Returns:
        The bound; None where the squares do not determine the variables, or where this
        remained open.
    """
    r = np.where(fixed, 0.0, residual)
    if not r.any():
        return 0.0
    squares = [t for t in program.terms if t.is_squares and t.weight]
    if not squares:
        return None
    fields = _fields(program, squares, fixed)
    beside = ~fixed
    for one in fields:
        beside[one.part] = False
    try:
        if fields and not beside.any():
            first = 0.5 * (1.0 + CLOSE) * sum(f.square(r, CLOSE**2) for f in fields)
            if first <= enough:
                return first
            return _by_steps(program, fields, fixed, r, enough)
        if fields and np.count_nonzero(beside) <= MOST:
            return _beside_parameters(squares, fields, r, beside)
        return _by_solving(program, squares, fixed, r)
    except NumericalError:  # of the multigrid: no bound without its solves
        return None


@dataclass(frozen=True)
class _Field:
    """A variable over the voxels and the term that determines it.

    Attributes:
        part: Its place in x.
        term: The term.
        laplace: The L of its rows, if these are L's.
        prior: The prior of the term: (RᵀR)⁻¹ of its rows R, zero at fixed values.
    """

    part: slice
    term: ProgramTerm
    laplace: LaplaceSystem
    prior: Prior = field(repr=False)

    def square(self, r: Array, rtol: float) -> float:
        """The field's part of rᵀA⁻¹r."""
        square = self.prior.within(rtol).square(r[self.part])
        return square / (2.0 * self.term.weight)

    def inverse(self, r: Array, rtol: float) -> Array:
        """The field's part of A⁻¹r, shape (V,)."""
        return self.prior.within(rtol).times(r[self.part]) / (2.0 * self.term.weight)


def _fields(program: Program, squares: list[ProgramTerm], fixed: Mask) -> list[_Field]:
    """The fields, each with a term that determines it; empty unless all have one."""
    laplace = program.laplace
    if laplace is None:
        return []
    fields = []
    for name, part in program.variables.items():
        if part.stop - part.start != len(laplace.free):
            continue
        tried = [field_of(term, name, part, fixed[part], laplace) for term in squares]
        determined = [one for one in tried if one is not None]
        if not determined:
            return []
        fields.append(determined[0])
    return fields


def field_of(
    term: ProgramTerm, name: str, part: slice, fixed: Mask, laplace: LaplaceSystem
) -> _Field | None:
    """A field whose term determines it and can be inverted; None otherwise.

    Args:
        term: The term.
        name: The field's name.
        part: Its place in x.
        fixed: Its voxels whose values are given, shape (V,).
        laplace: The scene's L.
    """
    known, rows = term.known_covariance, term.laplace_rows
    compliance = np.ones(len(fixed))
    if known is not None and name == "p" and not fixed.any():
        return _Field(part, term, laplace, known.covariance)
    if rows is None or rows.variable != name:
        return None
    # without rows of Dirichlet voxels, their values must be fixed
    if not (term.has_all_rows or fixed[~laplace.free].all()):
        return None
    if rows.scale is not None:
        compliance /= rows.scale**2
    compliance[fixed] = 0.0
    system = rows.system or laplace
    return _Field(part, term, system, LaplacePrior(system, compliance))


def _by_steps(
    program: Program, fields: list[_Field], fixed: Mask, r: Array, enough: float
) -> float | None:
    """Fields only: conjugate gradients until the bound is tight."""

    def precondition(values: Array) -> Array:
        out = np.empty_like(values)
        for one in fields:
            out[one.part] = one.inverse(values, RTOL)
        return out

    for step in _steps(program, fixed, r, precondition):
        if 0.5 * (step.known + step.rho) <= enough or step.rho <= CLOSE * step.known:
            return 0.5 * (step.known + step.rho)
    return None


def _by_solving(
    program: Program, squares: list[ProgramTerm], fixed: Mask, r: Array
) -> float | None:
    """Conjugate gradients to a small residual, preconditioned by L or the diagonal."""
    diagonal = np.zeros(len(r))
    for term in squares:
        diagonal += 2.0 * term.weight * term.column_squares()
    if r[diagonal == 0.0].any():  # no square determines these
        return None
    laplace = program.laplace
    like_L = laplace is not None and any(
        t.matrix.shape == laplace.L.shape and 10 * t.matrix.nnz > 9 * laplace.L.nnz
        for t in squares
    )

    def precondition(values: Array) -> Array:
        if like_L and len(values) == len(laplace.free):
            u = laplace.solve_adjoint(values, rtol=RTOL)
            u[fixed] = 0.0
            return laplace.solve(u, rtol=RTOL)
        return np.where(diagonal > 0.0, values / np.maximum(diagonal, _TINY), 0.0)

    first = None
    for step in _steps(program, fixed, r, precondition):
        first = step.rho if first is None else first
        if step.rho <= NOTHING * first:
            return 0.5 * step.known * (1.0 + CLOSE)
    return None


def _steps(
    program: Program, fixed: Mask, r: Array, precondition: _Map
) -> Iterator[Step]:
    """Conjugate gradients on P e = r over the free variables."""

    def image(direction: Array) -> Array:
        return np.where(fixed, 0.0, program.curvature_times(direction))

    def inverse(rest: Array) -> Array:
        return np.where(fixed, 0.0, precondition(rest))

    return steps(image, inverse, r, MAX_STEPS)


@dataclass(frozen=True)
class Step:
    """An iterate of conjugate gradients on H e = r.

    Attributes:
        e: Shape (n,).
        known: The accumulated sum towards rᵀH⁻¹r.
        rho: Squared norm of the residual in the preconditioner.
    """

    e: Array = field(repr=False)
    known: float
    rho: float


def steps(product: _Map, precondition: _Map, r: Array, most: int) -> Iterator[Step]:
    """Conjugate gradients from zero, until H or the preconditioner is not positive.

    Args:
        product: v ↦ H v, in a new array.
        precondition: v ↦ about H⁻¹v.
        r: Right-hand side, shape (n,).
        most: Most steps [–].
    """
    e, known, z = np.zeros_like(r), 0.0, precondition(r)
    rho, direction = float(r @ z), z
    for _ in range(most):
        if not (np.isfinite(rho) and rho >= 0.0):
            return
        yield Step(e, known, rho)
        image = product(direction)
        curvature = float(direction @ image)
        if not curvature > 0.0:
            return
        alpha = rho / curvature
        e, known, rest = e + alpha * direction, known + alpha * rho, r - alpha * image
        z = precondition(rest)
        before, rho = rho, float(rest @ z)
        # Polak and Ribière's rule, as preconditioners may be slightly nonlinear
        direction = z + (float(z @ (rest - r)) / before) * direction
        r = rest


def _beside_parameters(
    squares: list[ProgramTerm], fields: list[_Field], r: Array, others: Mask
) -> float | None:
    """Fields and a few parameters: the second inequality of the module's docstring."""
    known = [one.term for one in fields]
    rest = [t for t in squares if not any(t is mine for mine in known)]
    R = StackedTerms.of(rest, len(r), over=0.5).weighted
    at = np.flatnonzero(others)
    E, reduced = R[:, at].toarray(), r[at].copy()
    for one in fields:
        C = one.term.matrix[:, at].toarray()
        for k in np.flatnonzero(C.any(axis=0)):
            rows = one.term.laplace_rows
            if rows is None or rows.scale is not None:
                return None
            column = one.laplace.solve(C[:, k], rtol=RTOL)
            E[:, k] -= R[:, one.part] @ column
            reduced[k] -= float(column @ r[one.part])
    parts = [(one, sp.csr_array(R[:, one.part])) for one in fields]
    square = E.T @ E
    size, turn = np.linalg.eigh(square)
    seen = size > 1e-10 * max(float(size.max(initial=0.0)), _TINY)
    along = turn.T @ reduced
    if np.abs(along[~seen]).max(initial=0.0) > 1e-10 * np.abs(reduced).max(initial=0.0):
        return None
    of_parameters = float((along[seen] ** 2 / size[seen]).sum())
    of_fields = 2.0 * (1.0 + CLOSE) * sum(one.square(r, CLOSE**2) for one in fields)
    return 0.5 * (of_fields + (1.0 + 2.0 * _largest(parts, len(r))) * of_parameters)


def _largest(parts: list[tuple[_Field, sp.csr_array]], n: int) -> float:
    """A generous estimate of the largest eigenvalue of K = R A⁻¹Rᵀ."""
    y = np.random.default_rng(0).normal(size=parts[0][1].shape[0])
    size = 0.0
    for _ in range(POWER):
        length = float(np.linalg.norm(y))
        if length == 0.0:
            return 0.0
        y, image = y / length, np.zeros_like(y)
        for one, rows in parts:
            load = np.zeros(n)
            load[one.part] = rows.T @ y
            image += rows @ one.inverse(load, ROUGHLY)
        size, y = max(size, float(np.linalg.norm(image))), image
    return GENEROUS * size


def held_by_equalities(program: Program) -> Mask:
    """Variables that are fixed by equality rows with a single entry, shape (n,)."""
    fixed = np.zeros(program.n_variables, dtype=bool)
    for constraint in program.constraints:
        fixed[constraint.matrix[constraint.fixing].indices] = True
    return fixed
