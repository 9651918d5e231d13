"""The value of a searched parameter, and how well the data bear it.

J(v), the least objective for given values v of the searched parameters, is first made
small one parameter after the other (Brent's bounded search, loose fits), then seen as a
parabola through fits beside that place: its vertex is what is used, its curvature is
what standard errors are made from (`identification`).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.fitting.identification import (
    NOTHING_WEIGHS,
    SHARE,
    Estimate,
    judged_estimate,
    noise_variance,
)
from ttus_opt.fitting.parabola import Parabola, UnsolvedError
from ttus_opt.problem.formulation import Formulation, Search
from ttus_opt.problem.solution import Solution, Status

Solve = Callable[[Formulation], Solution]

#: Accuracy of the search, as a share of the range, and most fits for it
ACCURACY, MOST_FITS = 2e-2, 25

#: What an unsolved fit counts as, no place to stop at: above every objective, and
#: finite, for the search computes with it
UNSOLVED = 1e100

#: Distance of the parabola's points, as a share of the range: near enough that J is
#: one, far enough that differences of fits are no noise [–]
STEP = 0.02

#: Standard errors below this part of the step ask for a nearer parabola, and how much
#: nearer it may be [–]
NARROW, NEAREST = 0.25, 0.02

#: How often the parabola may be drawn anew around its own vertex
ROUNDS = 3


@dataclass(frozen=True)
class Found:
    """What a search gives.

    Attributes:
        formulation: At the values found, without a search.
        estimates: Of the searched parameters, by name; those in doubt have their
            neutral value.
        trouble: Why it is of no use; empty when it is.
    """

    formulation: Formulation = field(repr=False)
    estimates: Mapping[str, Estimate]
    trouble: str = ""


def searched(
    search: Search, loose: Solve, tight: Solve, doubts: Mapping[str, str]
) -> Found:
    """Search a parameter, and those that its formulations name in turn.

    Args:
        search: The first parameter.
        loose: Fits that show where to look.
        tight: Fits whose objectives can be told apart.
        doubts: Parameters that are known not to be identified, with the reason.

    Returns:
        Values and estimates. Whatever the data do not bear is given its neutral value
        and the rest is searched again.
    """
    known = dict(doubts)
    while True:
        try:
            values, chain = _minimum(search, loose, known)
            values, estimates = _estimates(search, chain, values, tight, known)
        except _NoMinimumError as trouble:
            return Found(trouble.nearest, {}, str(trouble))
        doubted = {n: e.doubt for n, e in estimates.items() if e.doubt}
        if not doubted:
            break
        # one at a time: without it the others may be well known
        name = next(iter(doubted))
        known[name] = doubted[name]
    for each in chain:
        if each.parameter in known:
            doubt = known[each.parameter]
            estimates[each.parameter] = Estimate(each.neutral, math.nan, doubt)
    return Found(_at(search, values), estimates)


class _NoMinimumError(Exception):
    """A search found nothing; the message says why."""

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
    """One parameter after the other at its least objective; the known are neutral."""
    values, chain = [], []
    level: Search | None = search
    while level is not None:
        neutral = level.parameter in known
        value = level.neutral if neutral else _least(level, solve)
        values.append(value)
        chain.append(level)
        level = level.build(value).search
    return values, chain


def _least(search: Search, solve: Solve) -> float:
    """The value of the least objective among solved fits.

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

    found = minimize_scalar(
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
            f"none of the fits along the search for {name} was solved, the last: "
            f"{advice}",
            search.build(search.neutral),
        )
    best = min(solved, key=solved.__getitem__)
    if not found.success:
        raise _NoMinimumError(
            f"the search for {name} did not end in {MOST_FITS} fits: narrow its range",
            search.build(best),
        )
    return best


class _DoubtedError(Exception):
    """Standard errors cannot be told; carries what is said of each instead."""

    def __init__(self, values: Array, doubts: Sequence[str], remark: str = "") -> None:
        super().__init__(remark)
        self.values, self.doubts, self.remark = values, doubts, remark


def _estimates(
    search: Search,
    chain: Sequence[Search],
    values: Sequence[float],
    solve: Solve,
    known: Mapping[str, str],
) -> tuple[list[float], dict[str, Estimate]]:
    """Values and estimates of the searched parameters from fits beside the optimum.

    Raises:
        _NoMinimumError: The optimum ran away from where it was found.
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

    start = np.array([values[i] for i in free])
    try:
        best = _settled(ranges, placed, solve, start)
    except _DoubtedError as said:
        placed(said.values)
        return every, {
            one.parameter: Estimate(value, math.nan, doubt, said.remark)
            for one, value, doubt in zip(
                ranges, said.values.tolist(), said.doubts, strict=True
            )
        }
    estimates = {
        one.parameter: _reported(one, k, best, placed) for k, one in enumerate(ranges)
    }
    placed(best.values)
    return every, estimates


@dataclass(frozen=True)
class _Optimum:
    """Where J is least.

    Attributes:
        values: Of the parameters, shape (k,).
        errors: Their standard errors, shape (k,).
        solution: Of a fit nearby.
    """

    values: Array
    errors: Array
    solution: Solution


def _settled(
    ranges: Sequence[Search],
    placed: Callable[[Array], Formulation],
    solve: Solve,
    start: Array,
) -> _Optimum:
    """The vertex of a parabola that is drawn around it.

    Raises:
        _NoMinimumError: It runs away.
        _DoubtedError: There is none, or a fit was not solved.
    """
    low, high = np.array([(one.low, one.high) for one in ranges]).T
    step, at, settled = STEP * (high - low), start, False
    nothing = [""] * len(ranges)

    def drawn(around: Array) -> Parabola:
        centre = np.clip(around, low + step, high - step)
        return Parabola.through(lambda v: solve(placed(v)), centre, step)

    for _ in range(ROUNDS):
        try:
            bowl = drawn(at)
        except UnsolvedError as trouble:
            remark = f"its standard error cannot be told: {trouble}"
            raise _DoubtedError(at, nothing, remark) from trouble
        if bowl.flat.any():
            raise _DoubtedError(at, [bowl.doubt * bool(flat) for flat in bowl.flat])
        at = np.clip(bowl.vertex, low, high)
        settled = bool((np.abs(at - bowl.centre) <= 2.0 * step).all())
        if settled:
            break
    variance = _variance(placed(bowl.centre), bowl.solution, len(ranges))
    if math.isnan(variance):
        raise _DoubtedError(at, [NOTHING_WEIGHS] * len(ranges))
    errors = bowl.errors(variance)
    if not settled and (errors <= SHARE * (high - low)).all():
        names = ", ".join(one.parameter for one in ranges)
        raise _NoMinimumError(f"the search for {names} does not settle", placed(at))
    if (errors < NARROW * step).any():
        # over many standard errors J is no parabola: once more, nearer
        step = np.clip(2.0 * errors, NEAREST * step, step)
        with contextlib.suppress(UnsolvedError):
            near = drawn(at)
            if not near.flat.any():
                at, errors = np.clip(near.vertex, low, high), near.errors(variance)
    return _Optimum(at, errors, bowl.solution)


def _reported(
    one: Search, k: int, best: _Optimum, placed: Callable[[Array], Formulation]
) -> Estimate:
    """The k-th parameter's estimate in the unit in which it is reported."""

    def told(value: float) -> float:
        moved = best.values.copy()
        moved[k] = value
        found = placed(moved).parameters(best.solution.variables)
        return found.get(one.parameter, float(value))

    low, high = told(one.low), told(one.high)
    rate = (high - low) / (one.high - one.low)
    return judged_estimate(
        told(best.values[k]),
        float(rate * best.errors[k]),
        high - low,
        low,
        high,
        told(one.neutral),
    )


def _variance(declared: Formulation, solution: Solution, n_searched: int) -> float:
    """Common variance of weighted rows at a solved fit."""
    assert solution.candidate is not None
    beside = declared.fitted(solution.variables).values()
    count = n_searched + sum(math.isfinite(one.span) for one in beside)
    return noise_variance(declared, solution.program, solution.candidate, count)
