"""The value of a searched parameter, and how well the data bear it.

J(v), the least objective for given values v of the searched parameters, is first made
small one parameter after the other (Brent's bounded search, loose fits), then seen as a
parabola through fits beside that place: its vertex is what is used, its curvature is
what standard errors are made from (`identification`).
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ttus_opt.identification import (
    NO_SLOPE,
    NOTHING_WEIGHS,
    SHARE,
    Estimate,
    judged_estimate,
    noise_variance,
)
from ttus_opt.problem.formulation import Formulation, Search
from ttus_opt.problem.solution import Solution, Status

Array = NDArray[np.float64]
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

#: What rounding leaves of the largest summand of J in a difference of two [–]
ROUNDING = 1e-12


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


class _UnsolvedError(Exception):
    """A fit beside the optimum was not solved; the message says so."""


@dataclass(frozen=True)
class _Parabola:
    """J near its minimum, through fits at distances of one step.

    Attributes:
        centre: Where it is drawn around, shape (k,).
        solution: Of the fit there.
        gradient: Of J at the centre, shape (k,).
        curvature: Second derivatives of J, shape (k, k).
        noise: What the second derivatives' diagonal may be off by, shape (k,).
    """

    centre: Array
    solution: Solution
    gradient: Array
    curvature: Array
    noise: Array

    @classmethod
    def through(
        cls, fitted: Callable[[Array], Solution], centre: Array, step: Array
    ) -> _Parabola:
        """Fit around a place.

        Args:
            fitted: The fit at given values.
            centre: The place, shape (k,).
            step: Distance of the other fits, shape (k,).

        Raises:
            _UnsolvedError: One of them was not solved.
        """
        k, doubt = len(centre), 0.0

        unit = np.eye(k, dtype=int)
        pairs = list(itertools.combinations(range(k), 2))
        places = [unit[0] * 0, *unit, *-unit, *(unit[i] + unit[j] for i, j in pairs)]
        found: dict[tuple[int, ...], Solution] = {}
        # sorted: what differs in the last parameters only follows one another, and
        # solvers keep most of their state there
        for signs in sorted(tuple(place.tolist()) for place in places):
            solution = fitted(centre + np.array(signs) * step)
            if solution.status is not Status.SOLVED or solution.kkt is None:
                raise _UnsolvedError("a fit beside it was not solved")
            rounding = ROUNDING * abs(solution.objective)
            doubt = max(doubt, solution.kkt.gap + rounding)
            found[signs] = solution

        def at(place: NDArray[np.int64]) -> float:
            return found[tuple(place.tolist())].objective

        J = at(unit[0] * 0)
        plus, minus = (np.array([at(s * e) for e in unit]) for s in (1, -1))
        curvature = np.diag((plus - 2.0 * J + minus) / step**2)
        for i, j in pairs:
            mixed = (at(unit[i] + unit[j]) - plus[i] - plus[j] + J) / step[i] / step[j]
            curvature[i, j] = curvature[j, i] = mixed
        return cls(
            centre,
            found[(0,) * k],
            (plus - minus) / (2.0 * step),
            curvature,
            4.0 * doubt / step**2,
        )

    @property
    def flat(self) -> NDArray[np.bool_]:
        """Which parameters J does not tell of, shape (k,)."""
        flat = np.diagonal(self.curvature) <= 2.0 * self.noise
        if not flat.any() and np.linalg.eigvalsh(self.curvature)[0] <= 0.0:
            flat[:] = True
        return np.asarray(flat)

    def errors(self, variance: float) -> Array:
        """Standard errors for a variance σ² of weighted rows, shape (k,)."""
        spread = 2.0 * variance * np.linalg.inv(self.curvature)
        return np.asarray(np.sqrt(np.diagonal(spread)))

    @property
    def vertex(self) -> Array:
        """Where it is least, shape (k,)."""
        return np.asarray(self.centre - np.linalg.solve(self.curvature, self.gradient))


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
    low, high = np.array([(chain[i].low, chain[i].high) for i in free]).T
    step = STEP * (high - low)

    def placed(at: Array) -> Formulation:
        for i, value in zip(free, at.tolist(), strict=True):
            every[i] = value
        return _at(search, every)

    at, settled = np.array([values[i] for i in free]), True
    for _ in range(ROUNDS):
        centre = np.clip(at, low + step, high - step)
        try:
            bowl = _Parabola.through(lambda v: solve(placed(v)), centre, step)
        except _UnsolvedError as trouble:
            remark = f"its standard error cannot be told: {trouble}"
            placed(at)
            return every, {
                chain[i].parameter: Estimate(every[i], math.nan, remark=remark)
                for i in free
            }
        if bowl.flat.any():
            bent = (np.diagonal(bowl.curvature) < -2.0 * bowl.noise).any()
            doubt = (
                "the objective has no least value in its range" if bent else NO_SLOPE
            )
            return every, {
                chain[i].parameter: Estimate(
                    every[i], math.nan, doubt if is_flat else ""
                )
                for i, is_flat in zip(free, bowl.flat, strict=True)
            }
        at = np.clip(bowl.vertex, low, high)
        if (np.abs(at - centre) <= 2.0 * step).all():
            break
    else:
        settled = False
    variance = _variance(placed(centre), bowl.solution, len(free))
    if math.isnan(variance):
        return every, {
            chain[i].parameter: Estimate(every[i], math.nan, NOTHING_WEIGHS)
            for i in free
        }
    errors = bowl.errors(variance)
    if not settled and (errors <= SHARE * (high - low)).all():
        names = ", ".join(chain[i].parameter for i in free)
        raise _NoMinimumError(f"the search for {names} does not settle", placed(at))
    if (errors < NARROW * step).any():
        # over many standard errors J is no parabola: once more, nearer
        step = np.clip(2.0 * errors, NEAREST * step, step)
        nearer = np.clip(at, low + step, high - step)
        with contextlib.suppress(_UnsolvedError):
            near = _Parabola.through(lambda v: solve(placed(v)), nearer, step)
            if not near.flat.any():
                at = np.clip(near.vertex, low, high)
                errors = near.errors(variance)
    estimates = {}
    for k, i in enumerate(free):
        name = chain[i].parameter
        marks = []
        for value in (at[k], low[k], high[k], chain[i].neutral):
            moved = at.copy()
            moved[k] = value
            told = placed(moved).parameters(bowl.solution.variables)
            marks.append(told.get(name, float(value)))
        rate = (marks[2] - marks[1]) / (high[k] - low[k])
        estimates[name] = judged_estimate(
            marks[0],
            float(rate * errors[k]),
            marks[2] - marks[1],
            *marks[1:],
        )
    placed(at)
    return every, estimates


def _variance(declared: Formulation, solution: Solution, n_searched: int) -> float:
    """Common variance of weighted rows at a solved fit."""
    assert solution.candidate is not None
    beside = declared.fitted(solution.variables).values()
    count = n_searched + sum(math.isfinite(one.span) for one in beside)
    return noise_variance(declared, solution.program, solution.candidate, count)
