"""Standard errors of the parameters beside the field, and their identifiability.

A fit minimises J(x) = ‖L p - b‖² + Σ λ ‖M x - t‖² over the field and a few parameters
c. The prior's rows and the measured rows, each times √λ, are assumed normal with one
common variance σ²: λ fixes their ratio, σ² is estimated. J(c), the minimum over all
else, is the profile likelihood (Golub and Pereyra, 1973, SIAM J. Numer. Anal. 10, 413)
and the exponent of the marginal likelihood (Rasmussen and Williams, 2006, eq. 2.30). At
the truth J/σ² is χ² with m degrees of freedom, m the measured rows of poses in contact,
and k fitted parameters take k of them:

    σ̂² = J_min/(m - k),   standard error of c = √(2 σ̂² (J''⁻¹)_cc)

(Bates and Watts, 1988, Nonlinear Regression Analysis, sec. 2.3 and 6.1; docs/method.md,
Standard errors). With correlated residuals, for example from a model error common to
many frames, the standard error is too small.

J'' of a searched parameter is a finite difference of fits (`parameter_search`). For a
parameter among the variables, cᵢ = aᵢᵀx, it follows from pseudo-measurements: with
Σ w (aᵢᵀx - vᵢ)² added, a change of v moves the solution by R = X (I + X)⁻¹ times that
change, X = 2w A J''⁻¹ Aᵀ, for any solver and any limits on the field.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.kkt import kkt_residuals
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import Point, reduce
from ttus_opt.problem.solution import Solution, Status
from ttus_opt.scene import Scene
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Prepared, Request, Solver
from ttus_opt.terms.base import Fitted

#: Largest standard error of an identified parameter, as a share of its plausible span:
#: ± 2 standard errors are then half of the span [–]
SHARE = 0.125

#: A value counts as at a limit when it is this near, as a share of its span [–]
AT_LIMIT = 1e-4

#: Standard deviation of a pseudo-measurement, as a share of `SHARE`: an identified
#: parameter then responds with 1 to 99 % of the change [–]
PRECISION = 0.1

#: Below a response of `FAINT` the pseudo-measurement is repeated with more precision;
#: above 1 - `FLAT` the objective is flat [–]
FAINT, FLAT = 1e-3, 1e-6

NO_SLOPE = "the objective does not depend on it"
NOTHING_PRESSES = "nothing slides in contact with a field that presses"
NOTHING_WEIGHS = "no measured row in contact has a weight"


@dataclass(frozen=True)
class Estimate:
    """Estimate of one parameter.

    Attributes:
        value: Its value.
        standard_error: NaN if unknown.
        doubt: Why it is not identified; empty if it is.
        remark: Further information.
    """

    value: float
    standard_error: float
    doubt: str = ""
    remark: str = ""


def noise_variance(
    declared: Formulation, program: Program, x: Array, n_parameters: int
) -> float:
    """Estimate of the common variance σ² of weighted rows.

    Args:
        declared: The formulation.
        program: Its matrices.
        x: Its minimiser, shape (n,).
        n_parameters: Number of parameters fitted beside the field [–].

    Returns:
        σ̂²; NaN unless there are more measured rows than parameters.
    """
    names = {term.name for term in declared.terms if term.measures}
    cost, count = program.objective(x), 0
    for term in program.terms:
        if term.name not in names or term.weight == 0.0:
            continue
        informative = np.asarray(abs(term.matrix).sum(axis=1)).reshape(-1) > 0.0
        cost -= term.weight * term.penalty.value(term.residual(x)[~informative])
        count += int(informative.sum())
    freedom = count - n_parameters
    return max(cost, 0.0) / freedom if freedom > 0 else math.nan


def judged_estimate(
    value: float,
    standard_error: float,
    span: float,
    low: float,
    high: float,
    neutral: float = 0.0,
) -> Estimate:
    """Decide whether a parameter is identified.

    Args:
        value: Its value.
        standard_error: Its standard error.
        span: Width of its plausible range.
        low: Its lower limit.
        high: Its upper limit.
        neutral: Its neutral value; a limit equal to it is a valid estimate.
    """
    near = AT_LIMIT * (span if math.isfinite(span) else 1.0)
    doubt, remark = "", ""
    if math.isinf(standard_error):
        doubt = NO_SLOPE
    elif value >= high - near:
        doubt = f"at its upper limit {high:.4g}"
    elif standard_error > SHARE * span:
        doubt = f"the data give {value:.2g} ± {standard_error:.2g}"
    elif value <= low + near:
        remark = f"at its lower limit {low:.4g}"
        if abs(low - neutral) > near:
            doubt, remark = remark, ""
    return Estimate(value, standard_error, doubt, remark)


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
    program, x = solution.program, solution.candidate
    n_own = sum(math.isfinite(one.span) for one in fitted.values())
    variance = noise_variance(declared, program, x, n_searched + n_own)
    values = {name: solution.parameters[name] for name in fitted}
    if math.isnan(variance):
        return {n: Estimate(v, math.nan, NOTHING_WEIGHS) for n, v in values.items()}
    if not all(one.gradient for one in fitted.values()):
        return {n: Estimate(v, math.nan, NOTHING_PRESSES) for n, v in values.items()}
    pseudo = _PseudoMeasurements(solution, fitted, variance, request, solver)
    try:
        spread = pseudo.covariance()
    except _NoResponseError as trouble:
        remark = f"its standard error is unknown: {trouble}"
        errors = [math.nan] * len(fitted)
    else:
        remark, errors = "", np.sqrt(np.diagonal(spread)).tolist()
    estimates = {
        name: judged_estimate(values[name], error, one.span, 0.0, pseudo.upper(one))
        for (name, one), error in zip(fitted.items(), errors, strict=True)
    }
    # a value at a limit is not identified, whatever its standard error
    return {
        name: estimate
        if estimate.doubt or not remark
        else replace(estimate, remark=remark)
        for name, estimate in estimates.items()
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

    def covariance(self) -> Array:
        """Covariance of the parameters, shape (r, r).

        Raises:
            _NoResponseError: A fit was not solved, or the response is noise.
        """
        response = self._response()
        faint = np.diagonal(response) < FAINT
        if faint.any():
            # scaled by the first response, down to what can be resolved
            known = np.sqrt(np.maximum(np.diagonal(response), FAINT**3))
            self._deviation = self._deviation * np.where(faint, known, 1.0)
            response = self._response()
        size = np.diagonal(response)
        if (size <= FAINT**2).any():
            raise _NoResponseError("the fit does not respond to pseudo-measurements")
        if (size >= 1.0 - FLAT).any():
            flat = np.where(size >= 1.0 - FLAT, np.inf, 0.0)
            return np.diag(flat)
        weights = self._energy / self._deviation**2
        rest = np.linalg.inv(np.eye(len(size)) - response)
        spread = rest @ response / (2.0 * weights)
        spread = self._variance * (spread + spread.T)
        if (np.diagonal(spread) < 0.0).any():
            raise _NoResponseError("its response to pseudo-measurements is noise")
        return np.asarray(spread)

    def _response(self) -> Array:
        """Change of the parameters per unit change of each pseudo-measurement."""
        root = np.sqrt(self._energy) / self._deviation
        matrix = sp.csr_array(sp.diags_array(root) @ self._rows)
        changes = np.diag(self._deviation)
        prepared, backend, found = None, None, []
        if self._settled:
            found.append(self._at)
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
            found.append(self._rows @ x)
        return np.stack([(a - found[0]) for a in found[1:]], axis=1) / self._deviation

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


def with_estimates(
    solution: Solution,
    scene: Scene,
    estimates: Mapping[str, Estimate],
    doubts: Mapping[str, str],
    trouble: str = "",
) -> Solution:
    """Add standard errors of the parameters, or the reasons for missing ones.

    Args:
        solution: A solution with neutral values of parameters not identified.
        scene: Its estimates of the solution's parameters are included.
        estimates: Estimates of the parameters, by name.
        doubts: Why a parameter is not identified, by name.
        trouble: Why the search failed; the solution then does not count as solved.
    """
    own = solution.parameters.keys()
    errors = {n: e for n, e in scene.standard_errors.items() if n in own}
    unknown = {n: why for n, why in scene.not_identified.items() if n in own}
    for name, estimate in estimates.items():
        errors[name] = estimate.standard_error
    errors = {
        name: error
        for name, error in errors.items()
        if math.isfinite(error) and name not in doubts
    }
    field = solution.verified_field
    if field is not None:
        field = replace(field, standard_errors=errors)
    solution = replace(
        solution,
        standard_errors=errors,
        not_identified={**unknown, **doubts},
        remarks={
            name: estimate.remark
            for name, estimate in estimates.items()
            if estimate.remark and name not in doubts
        },
        verified_field=field,
    )
    if not trouble:
        return solution
    solved = solution.status is Status.SOLVED
    return replace(
        solution,
        status=Status.INACCURATE if solved else solution.status,
        detail=f"{trouble}: {solution.detail}" if solution.detail else trouble,
        verified_field=None,
    )
