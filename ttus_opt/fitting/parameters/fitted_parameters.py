"""Standard errors of parameters among the variables, by pseudo-measurements.

For a parameter cᵢ = aᵢᵀx the curvature J'' of the profile (`identification`) follows
from fits with Σ w (aᵢᵀx - vᵢ)² added: a change of v moves the solution by
R = X (I + X)⁻¹ times that change, X = 2w A J''⁻¹ Aᵀ, for any solver and any limits on
the field. The same fits give the derivatives of the residuals by which errors that a
place shares are accounted for (`identification.PlaceRows`). See
docs/method/identification.md, 13.3.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.places import UNKNOWN, PlaceErrors
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.parameters.identification import (
    AT_LIMIT,
    NOTHING_PRESSES,
    NOTHING_WEIGHS,
    SHARE,
    Estimate,
    PlaceRows,
    judged_estimate,
    noise_variance,
)
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import Point, reduce
from ttus_opt.problem.solution import Solution, Status
from ttus_opt.problem.terms.base import Fitted
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Prepared, Request, Solver

#: Standard deviation of a pseudo-measurement, as a share of `SHARE`: an identified
#: parameter then responds with 1 to 99 % of the change [–]
PRECISION = 0.1

#: Below a response of `FAINT` the pseudo-measurement is repeated with more precision;
#: above 1 - `FLAT` the objective is flat [–]
FAINT, FLAT = 1e-3, 1e-6


def fitted_estimates(
    declared: Formulation,
    solution: Solution,
    request: Request,
    n_searched: int = 0,
    solver: Solver | None = None,
) -> dict[str, Estimate]:
    """Estimates of the parameters among the variables of a solved fit.

    Args:
        declared: The formulation.
        solution: Its solution.
        request: Tolerance and time limit of the additional fits.
        n_searched: Number of searched parameters [–].
        solver: Solver of the additional fits; by default the solution's, by name.

    Returns:
        By name; empty without a solved fit or such parameters.
    """
    if solution.status is not Status.SOLVED or solution.candidate is None:
        return {}
    fitted = declared.fitted(solution.variables)
    if not fitted:
        return {}
    variance = noise_variance(declared, solution, n_searched)
    values = {name: solution.parameters[name] for name in fitted}
    if math.isnan(variance):
        return {n: Estimate(v, math.nan, NOTHING_WEIGHS) for n, v in values.items()}
    if not all(one.gradient for one in fitted.values()):
        return {n: Estimate(v, math.nan, NOTHING_PRESSES) for n, v in values.items()}
    pseudo = _PseudoMeasurements(solution, fitted, variance, request, solver)
    try:
        errors = pseudo.errors(PlaceRows.of(declared.scene, solution.program))
    except _NoResponseError as trouble:
        unknown = f"its standard error is unknown: {trouble}"
        errors = [(math.nan, unknown)] * len(fitted)
    # a value at a limit is not identified, whatever its standard error
    return {
        name: judged_estimate(
            values[name], error, one.span, 0.0, pseudo.upper(one)
        ).remarked(remark)
        for (name, one), (error, remark) in zip(fitted.items(), errors, strict=True)
    }


class _NoResponseError(Exception):
    """A fit with pseudo-measurements failed; the message says why."""


class _PseudoMeasurements:
    """Pseudo-measurements of the parameters of a solution."""

    def __init__(
        self,
        solution: Solution,
        fitted: Mapping[str, Fitted],
        variance: float,
        request: Request,
        solver: Solver | None,
    ) -> None:
        program, x = solution.program, solution.candidate
        assert x is not None
        self._variance, self._request = variance, request
        self._solver = solver or solution.solver
        self._near = Point(x, solution.duals)
        self._rows = _stacked(program, fitted.values())
        self._found: list[Array] = []  # solutions without and with each change
        self._at = self._rows @ x
        spans = np.array([one.span for one in fitted.values()])
        finite = np.isfinite(spans)
        spans[~finite] = spans[finite].min(initial=np.inf)
        # where the field is zero, the span of drag is zero too
        self._deviation = PRECISION * SHARE * np.where(spans > 0.0, spans, 1.0)
        self._box = program.box
        # the parameters' own limits would hide the curvature
        small = [
            part
            for name, part in program.variables.items()
            if any(name in one.gradient for one in fitted.values())
            and part.stop - part.start < program.variables["p"].stop
        ]
        bounds = tuple(b for b in program.bounds if b.part not in small)
        self._program = replace(program, bounds=bounds)
        inside = [
            _within(x[part], *(limit[part] for limit in self._box)) for part in small
        ]
        # whether the solution is also the minimum without these limits
        self._settled = all(inside)
        # with noise-free data the variance is rounding error
        size = sum(
            t.weight * float(t.target @ t.target)
            for t in program.terms
            if t is not program.laplace_term
        )
        rows = sum(len(t.target) for t in program.terms if t.weight > 0.0)
        self._energy = max(variance, 1e-6 * size / max(rows, 1), np.finfo(float).tiny)

    def upper(self, one: Fitted) -> float:
        """The largest value of a parameter."""
        highest = one.upper
        if len(one.gradient) == 1:
            (name, gradient), *_ = one.gradient.items()
            part = self._program.variables[name]
            if len(gradient) == 1:
                highest = min(highest, float(self._box[1][part][0]))
        return highest

    def errors(self, rows: PlaceRows | None) -> list[tuple[float, str]]:
        """Standard errors of the parameters, each with a remark.

        Args:
            rows: The measured rows by place; None where unknown.

        Raises:
            _NoResponseError: A fit was not solved, or the response is noise.
        """
        response = self._settled_response()
        inverse = self._inverse(response)
        usual = np.sqrt(2.0 * self._variance * np.diagonal(inverse))
        if not np.isfinite(inverse).all():  # no slope: not identified
            return [(error, "") for error in usual.tolist()]
        shared = PlaceErrors(usual, (UNKNOWN,) * len(usual))
        if rows is not None:
            base, *others = (rows.residuals(self._program, x) for x in self._found)
            moved = np.stack([u - base for u in others], axis=1) / self._deviation
            # H C, as moved = H R and C is that of `_inverse`
            left = np.linalg.inv(np.eye(len(usual)) - response)
            pull = moved @ left * (self._deviation**2 / (2.0 * self._energy))
            shared = rows.errors(usual, base, pull, np.diagonal(inverse))
        return list(zip(shared.errors.tolist(), shared.remarks, strict=True))

    def _settled_response(self) -> Array:
        """The response to pseudo-measurements of suitable precision."""
        response = self._response()
        faint = np.diagonal(response) < FAINT
        if faint.any():
            # scaled by the first response, down to what can be resolved
            known = np.sqrt(np.maximum(np.diagonal(response), FAINT**3))
            self._deviation = self._deviation * np.where(faint, known, 1.0)
            response = self._response()
        return response

    def _inverse(self, response: Array) -> Array:
        """(J'')⁻¹ of the parameters, shape (r, r)."""
        size = np.diagonal(response)
        if (size <= FAINT**2).any():
            raise _NoResponseError("the fit does not respond to pseudo-measurements")
        if (size >= 1.0 - FLAT).any():
            flat = np.where(size >= 1.0 - FLAT, np.inf, 0.0)
            return np.diag(flat)
        weights = self._energy / self._deviation**2
        rest = np.linalg.inv(np.eye(len(size)) - response)
        inverse = rest @ response / (4.0 * weights)
        inverse = inverse + inverse.T
        if (np.diagonal(inverse) < 0.0).any():
            raise _NoResponseError("its response to pseudo-measurements is noise")
        return np.asarray(inverse)

    def _response(self) -> Array:
        """Change of the parameters per unit change of each pseudo-measurement."""
        root = np.sqrt(self._energy) / self._deviation
        matrix = sp.csr_array(sp.diags_array(root) @ self._rows)
        changes = np.diag(self._deviation)
        prepared, backend, moved = None, None, []
        if self._settled:
            moved.append(self._near.x)
        else:
            changes = np.vstack([np.zeros(len(root)), changes])
        for change in changes:
            pseudo = ProgramTerm(
                "pseudo-measurement", 1.0, matrix, root * (self._at + change)
            )
            program = replace(self._program, terms=(*self._program.terms, pseudo))
            if backend is None:
                try:
                    backend = registry.choose(self._solver, reduce(program).program)
                except InputError as error:
                    raise _NoResponseError(str(error)) from error
            x, prepared = self._solved(program, backend, prepared)
            moved.append(x)
        self._found = moved
        base, *others = (self._rows @ x for x in moved)
        return np.stack([a - base for a in others], axis=1) / self._deviation

    def _solved(
        self, program: Program, backend: Solver, prepared: Prepared | None
    ) -> tuple[Array, Prepared]:
        reduction = reduce(program)
        if prepared is None:
            prepared = backend.prepare(reduction.program, self._request)
            near = reduction.lift(self._near.x, self._near.duals)
            prepared.start_at(near.x, near.duals)
        else:
            prepared.update(reduction.program)
        candidate = prepared.solve()
        if candidate.x is None:
            raise _NoResponseError("a fit with a pseudo-measurement has no solution")
        point = reduction.restore(candidate.x, candidate.duals)
        worst = kkt_residuals(program, point.x, point.duals).worst_relative
        if not worst <= self._request.tolerance:
            raise _NoResponseError("a fit with a pseudo-measurement was not solved")
        return point.x, prepared


def _stacked(program: Program, fitted: Iterable[Fitted]) -> sp.csr_array:
    """Gradients over all variables, a row per parameter."""
    rows = []
    for one in fitted:
        row = np.zeros(program.n_variables)
        for name, gradient in one.gradient.items():
            row[program.variables[name]] = gradient
        rows.append(sp.csr_array(row[None, :]))
    return sp.csr_array(sp.vstack(rows, format="csr"))


def _within(x: Array, lower: Array, upper: Array) -> bool:
    """Whether x is away from both limits."""
    near = AT_LIMIT * np.abs(x)
    return bool(((x - lower > near) & (upper - x > near)).all())
