"""Standard errors of the parameters beside the field, and their identifiability.

A fit minimises J(x) = ‖L p - b‖² + Σ λ ‖M x - t‖² over the field and a few parameters
c. The prior's rows and the measured rows, each times √λ, are assumed normal with one
common variance σ²: λ fixes their ratio, σ² is estimated. J(c), the minimum over all
else, is the profile likelihood (Golub and Pereyra, 1973, SIAM J. Numer. Anal. 10, 413)
and the exponent of the marginal likelihood (Rasmussen and Williams, 2006, eq. 2.30). At
the truth J/σ² is χ² with m degrees of freedom, m the measured rows of poses in contact,
and k fitted parameters take k of them:

    σ̂² = J_min/(m - k),   standard error of c = √(2 σ̂² (J''⁻¹)_cc)

(Bates and Watts, 1988, Nonlinear Regression Analysis, sec. 2.3 and 6.1;
docs/method/identification.md, Standard errors). Frames of a place share what the model
has wrong there; the larger one of this standard error and that by places
(`ttus_opt.contact.places`) is reported. J'' is a finite difference of fits for a
searched parameter (`parameter_search`), and follows from pseudo-measurements for one
among the variables (`fitted_parameters`).

For errors shared by a place (`PlaceRows`), the residuals of a few fits beside the
optimum, which any solver may make, give their derivatives along the profile
(`ttus_opt.contact.places`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from ttus_opt.contact.places import PlaceErrors, place_errors
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import warn
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.program import Program
from ttus_opt.problem.solution import Solution, Status
from ttus_opt.problem.terms.distinct_drag import ONE_SENSE

#: Largest standard error of an identified parameter, as a share of its plausible span:
#: ± 2 standard errors are then half of the span [–]
SHARE = 0.125

#: A value counts as at a limit when it is this near, as a share of its span [–]
AT_LIMIT = 1e-4

NO_SLOPE = "the objective does not depend on it"
NOTHING_PRESSES = "nothing slides in contact with a field that presses"
NOTHING_WEIGHS = "no measured row in contact has a weight"


@dataclass(frozen=True)
class Estimate:
    """Estimate of one parameter.

    Attributes:
        value: Its value.
        standard_error: NaN if unknown.
        reason: Why it is not identified; empty if it is.
        remark: Further information.
    """

    value: float
    standard_error: float
    reason: str = ""
    remark: str = ""

    def remarked(self, remark: str) -> Self:
        """With a further remark, where the parameter is identified."""
        if self.reason or not remark:
            return self
        return replace(self, remark="; ".join(filter(None, (self.remark, remark))))


def noise_variance(declared: Formulation, solution: Solution, n_searched: int) -> float:
    """Estimate of the common variance σ² of weighted rows.

    Args:
        declared: The formulation.
        solution: With its minimiser.
        n_searched: Number of searched parameters, beside the fitted ones [–].

    Returns:
        σ̂²; NaN unless there are more measured rows than parameters.
    """
    program, x = solution.program, solution.candidate
    assert x is not None
    names = {term.name for term in declared.terms if term.measures}
    cost, count = program.objective(x), 0
    for term in program.terms:
        if term.name not in names or term.weight == 0.0:
            continue
        informative = np.asarray(abs(term.matrix).sum(axis=1)).reshape(-1) > 0.0
        cost -= term.weight * term.penalty.value(term.residual(x)[~informative])
        count += int(informative.sum())
    fitted = declared.fitted(solution.variables).values()
    freedom = count - n_searched - sum(math.isfinite(one.span) for one in fitted)
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
    reason, remark = "", ""
    if math.isinf(standard_error):
        reason = NO_SLOPE
    elif value >= high - near:
        reason = f"at its upper limit {high:.4g}"
    elif standard_error > SHARE * span:
        reason = f"the data give {value:.2g} ± {standard_error:.2g}"
    elif value <= low + near:
        remark = f"at its lower limit {low:.4g}"
        if abs(low - neutral) > near:
            reason, remark = remark, ""
    return Estimate(value, standard_error, reason, remark)


def with_estimates(
    solution: Solution,
    scene: Scene,
    estimates: Mapping[str, Estimate],
    reasons: Mapping[str, str],
    trouble: str = "",
) -> Solution:
    """Add standard errors of the parameters, or the reasons for missing ones.

    Args:
        solution: A solution with neutral values of parameters not identified.
        scene: Its estimates of the solution's parameters are included.
        estimates: Estimates of the parameters, by name.
        reasons: Why a parameter is not identified, by name.
        trouble: Why the search failed; the solution then does not count as solved.
    """
    known = solution.parameters.keys()
    unknown = {n: why for n, why in scene.not_identified.items() if n in known}
    errors = {n: e for n, e in scene.standard_errors.items() if n in known}
    errors |= {name: one.standard_error for name, one in estimates.items()}
    told = (n for n, e in errors.items() if math.isfinite(e) and n not in reasons)
    errors = {name: errors[name] for name in told}
    field = solution.verified_field
    if field is not None:
        field = replace(field, standard_errors=errors)
    solution = replace(
        solution,
        standard_errors=errors,
        not_identified={**unknown, **reasons},
        remarks={
            name: estimate.remark
            for name, estimate in estimates.items()
            if estimate.remark and name not in reasons
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


def warn_of_untold_friction(declared: Formulation, done: str) -> None:
    """Warn that friction of a formulation cannot be told from an elastic force.

    Args:
        declared: Nothing is said of formulations for which this is not so, or whose
            coefficient is given.
        done: What is done about it.
    """
    unknowns = {name for term in declared.terms for name in term.assembled.blocks}
    if declared.search is None and unknowns == {"p"}:
        return
    reasons = declared.not_identifiable().items()
    named = ", ".join(name for name, why in reasons if why == ONE_SENSE)
    if named:
        warn(
            f"{declared.name}: {named} cannot be told from an elastic force "
            f"({ONE_SENSE}): {done}; record the release of every press too, or slide "
            "the probe along the skin",
            2,
        )


@dataclass(frozen=True)
class PlaceRows:
    """The measured rows of a program, by place.

    Attributes:
        names: Measured terms.
        rows: Their rows in contact, as each term has them, shape (r,) [–].
        place: Place of each of these, shape (r,) [–].
    """

    names: tuple[str, ...]
    rows: IntArray = field(repr=False)
    place: IntArray = field(repr=False)

    @classmethod
    def of(cls, scene: Scene, program: Program) -> Self | None:
        """The rows of a scene's measurements.

        Returns:
            None where rows are not squares, three per frame: their places are unknown.
        """
        terms = [t for t in program.terms if t.is_measured and t.weight > 0.0]
        n = 3 * len(scene.trajectory)
        if not all(t.is_squares and len(t.target) in (0, n) for t in terms):
            return None
        used = [term for term in terms if len(term.target)]
        rows = np.flatnonzero(np.repeat(scene.touching, 3))
        place = np.repeat(scene.places, 3)[rows]
        return cls(tuple(term.name for term in used), rows, place)

    def residuals(self, program: Program, x: Array) -> Array:
        """√λ (M x - t) of a fit, one term after the other, shape (m,)."""
        terms = [t for t in program.terms if t.name in self.names]
        each = [np.sqrt(t.weight) * t.residual(x)[self.rows] for t in terms]
        return np.concatenate([*each, np.zeros(0)])

    def errors(
        self, usual: Array, rest: Array, pull: Array, scale: Array
    ) -> PlaceErrors:
        """Standard errors by places, as `place_errors`."""
        place = np.tile(self.place, len(self.names))
        return place_errors(usual, rest, pull, scale, place)
