"""Search for parameters that are not variables of the program, with standard errors.

J(v) is the minimum of the objective for given values v of the searched parameters. It
is first minimised over one parameter after the other (Brent's bounded search, fits of
low accuracy), unless an estimate is known. A parabola through accurate fits around that
point then gives the values (its vertex) and the standard errors (its curvature, see
`identification`). Where there is none beside an estimate, the whole range is searched.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ttus_opt.contact.places import PlaceErrors
from ttus_opt.core.arrays import Array
from ttus_opt.fitting.parameters.identification import (
    NOTHING_WEIGHS,
    SHARE,
    Estimate,
    PlaceRows,
    judged_estimate,
    noise_variance,
)
from ttus_opt.fitting.parameters.parabola import Parabola
from ttus_opt.problem.formulation import Formulation, Search
from ttus_opt.problem.solution import Solution, Status

Solve = Callable[[Formulation], Solution]

#: Accuracy of the search, as a share of the range, and its largest number of fits
ACCURACY, MOST_FITS = 2e-2, 25

#: Objective of an unsolved fit: above all others but finite, for Brent's method
UNSOLVED = 1e100

#: Distance of the parabola's points, as a share of the range: small enough for J to be
#: nearly quadratic, large enough for differences of fits to exceed their noise [–]
STEP = 0.02

#: Standard errors below this share of the step call for a smaller step; the smallest
#: step, as a share of the first [–]
NARROW, NEAREST = 0.25, 0.02

#: Said of a parameter where the parabola misses a fit
UNSOLVED_BESIDE = "its standard error is unknown: a fit beside it was not solved"

#: Most parabolas, each centred on the vertex of the last one
ROUNDS = 3


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    Attributes:
        formulation: The formulation at these values, without a search.
        estimates: The searched parameters, by name; those not identified have their
            neutral value.
        trouble: Why the search failed; empty if it succeeded.
    """

    formulation: Formulation = field(repr=False)
    estimates: Mapping[str, Estimate]
    trouble: str = ""


def search_parameters(
    search: Search, loose: Solve, tight: Solve, reasons: Mapping[str, str]
) -> SearchResult:
    """Search for a parameter, and for those of nested searches.

    A parameter that is not identified gets its neutral value, and the others are
    searched again.

    Args:
        search: The first parameter.
        loose: Fits of low accuracy, to find the neighbourhood.
        tight: Fits accurate enough for differences of objectives.
        reasons: Known reasons why a parameter is not identified, by name.
    """
    known = dict(reasons)
    while True:
        try:
            values, chain = _minimum(search, loose, known)
            values, estimates = _estimates(search, chain, values, tight, known)
        except _NoMinimumError as trouble:
            if search.likely is None:
                return SearchResult(trouble.nearest, {}, str(trouble))
            estimates = {search.parameter: Estimate(math.nan, math.nan, str(trouble))}
        unidentified = {n: e.reason for n, e in estimates.items() if e.reason}
        known_errors = all(math.isfinite(e.standard_error) for e in estimates.values())
        if search.likely is not None and (unidentified or not known_errors):
            search = replace(search, likely=None)
            continue
        if not unidentified:
            break
        # one at a time: with it fixed the others may be identified
        name = next(iter(unidentified))
        known[name] = unidentified[name]
    for each in chain:
        if each.parameter in known:
            reason = known[each.parameter]
            estimates[each.parameter] = Estimate(each.neutral_value, math.nan, reason)
    return SearchResult(_at(search, values), estimates)


class _NoMinimumError(Exception):
    """A search failed; the message says why."""

    def __init__(self, message: str, nearest: Formulation) -> None:
        super().__init__(message)
        self.nearest = nearest


def _at(search: Search, values: Sequence[float]) -> Formulation:
    """The formulation at given values of a chain of searches."""
    built = search.build(float(values[0]))
    for value in values[1:]:
        assert built.search is not None
        built = built.search.build(float(value))
    return built


def _minimum(
    search: Search, solve: Solve, known: Mapping[str, str]
) -> tuple[list[float], list[Search]]:
    """Minimise over one parameter after the other; those in ``known`` are neutral."""
    values, chain = [], []
    level: Search | None = search
    while level is not None:
        if level.parameter in known:
            value = level.neutral_value
        else:
            value = _least(level, solve) if level.likely is None else level.likely
        values.append(value)
        chain.append(level)
        level = level.build(value).search
    return values, chain


def _least(search: Search, solve: Solve) -> float:
    """The value with the least objective among solved fits.

    Raises:
        _NoMinimumError: No fit was solved, or the search did not end.
    """
    from scipy.optimize import minimize_scalar

    solved: dict[float, float] = {}
    advice = ""

    def objective(value: float) -> float:
        nonlocal advice
        solution = solve(search.build(float(value)))
        if solution.status is not Status.SOLVED:
            advice = solution.advice
            return UNSOLVED
        solved[float(value)] = solution.objective
        return solution.objective

    least = minimize_scalar(
        objective,
        bounds=(search.low, search.high),
        method="bounded",
        options={
            "xatol": ACCURACY * (search.high - search.low),
            "maxiter": MOST_FITS,
        },
    )
    name = search.parameter
    if not solved:
        raise _NoMinimumError(
            f"the search for {name} solved none of its fits, the last: {advice}",
            search.build(search.neutral_value),
        )
    best = min(solved, key=solved.__getitem__)
    if not least.success:
        raise _NoMinimumError(
            f"the search for {name} did not converge in {MOST_FITS} fits: narrow its "
            "range",
            search.build(best),
        )
    return best


def _estimates(
    search: Search,
    chain: Sequence[Search],
    values: Sequence[float],
    solve: Solve,
    known: Mapping[str, str],
) -> tuple[list[float], dict[str, Estimate]]:
    """Values and estimates of the searched parameters from fits beside the optimum.

    Raises:
        _NoMinimumError: The parabola's vertex does not settle.
    """
    every = list(values)
    free = [i for i, s in enumerate(chain) if s.parameter not in known]
    if not free:
        return every, {}
    ranges = [chain[i] for i in free]

    def placed(at: Array) -> Formulation:
        for i, value in zip(free, at.tolist(), strict=True):
            every[i] = value
        return _at(search, every)

    best, estimates = _settled(
        ranges, placed, solve, np.array([values[i] for i in free])
    )
    placed(best)
    names = (one.parameter for one in ranges)
    return every, dict(zip(names, estimates, strict=True))


def _settled(
    ranges: Sequence[Search],
    placed: Callable[[Array], Formulation],
    solve: Solve,
    start: Array,
) -> tuple[Array, list[Estimate]]:
    """The vertex of a parabola centred on itself, and estimates of its parameters.

    Raises:
        _NoMinimumError: It does not settle.
    """
    low, high = np.array([(one.low, one.high) for one in ranges]).T
    step, at, settled = STEP * (high - low), start, False

    def parabola_at(around: Array) -> Parabola | None:
        centre = np.clip(around, low + step, high - step)
        return Parabola.through(lambda v: solve(placed(v)), centre, step)

    for _ in range(ROUNDS):
        parabola = parabola_at(at)
        if parabola is None:
            return at, _unknown(at, [""] * len(ranges), UNSOLVED_BESIDE)
        if parabola.flat.any():
            return at, _unknown(
                at, [parabola.reason * bool(flat) for flat in parabola.flat]
            )
        at = np.clip(parabola.vertex, low, high)
        settled = bool((np.abs(at - parabola.centre) <= 2.0 * step).all())
        if settled:
            break
    assert parabola is not None
    variance = noise_variance(placed(parabola.centre), parabola.solution, len(ranges))
    if math.isnan(variance):
        return at, _unknown(at, [NOTHING_WEIGHS] * len(ranges))
    errors = parabola.errors(variance)
    if not settled and (errors <= SHARE * (high - low)).all():
        names = ", ".join(one.parameter for one in ranges)
        raise _NoMinimumError(f"the search for {names} does not converge", placed(at))
    if (errors < NARROW * step).any():
        # the step covers many standard errors: again with a smaller one
        step = np.clip(2.0 * errors, NEAREST * step, step)
        near = parabola_at(at)
        if near is not None and not near.flat.any():
            at, errors = np.clip(near.vertex, low, high), near.errors(variance)
            parabola = near
    rows = PlaceRows.of(placed(parabola.centre).scene, parabola.solution.program)
    shared = parabola.place_errors(errors, rows)
    solution = parabola.solution
    return at, [
        _reported(
            one, k, at, shared, lambda v: placed(v).parameters(solution.variables)
        )
        for k, one in enumerate(ranges)
    ]


def _unknown(at: Array, reasons: Sequence[str], remark: str = "") -> list[Estimate]:
    """Estimates without a standard error."""
    pairs = zip(at.tolist(), reasons, strict=True)
    return [Estimate(value, math.nan, reason, remark) for value, reason in pairs]


def _reported(
    one: Search,
    k: int,
    at: Array,
    shared: PlaceErrors,
    parameters: Callable[[Array], Mapping[str, float]],
) -> Estimate:
    """The k-th parameter's estimate, in its reported unit."""

    def reported(value: float) -> float:
        moved = at.copy()
        moved[k] = value
        return parameters(moved).get(one.parameter, float(value))

    low, high = reported(one.low), reported(one.high)
    rate = (high - low) / (one.high - one.low)
    error, neutral = float(rate * shared.errors[k]), reported(one.neutral_value)
    estimate = judged_estimate(reported(at[k]), error, high - low, low, high, neutral)
    return estimate.remarked(shared.remarks[k])
