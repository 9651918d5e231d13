"""Fit: formulation and solver in, verified solution out."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.fitting.identification import fitted_estimates, with_estimates
from ttus_opt.fitting.parameter_search import Found, searched
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.certificate import falling_ray
from ttus_opt.problem.conflict import conflicting
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.kkt import KKT, kkt_residuals
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import Reduction, reduce
from ttus_opt.problem.solution import Attempt, Solution, Status, Timings
from ttus_opt.scene import Scene
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Candidate, Claim, Request
from ttus_opt.voxmap.field import PotentialField

#: Seconds spent on naming the constraints in conflict, when no limit is given
CONFLICT_SECONDS = 30.0

#: KKT tolerance of the fits along a search; the last one has the tolerance asked for
SEARCH_TOLERANCE = 1e-4

#: Claims that take an answer back, unless the residuals prove it without the solver
_DOUBTS = (Claim.DOUBTS, Claim.GAVE_UP, Claim.INFEASIBLE, Claim.UNBOUNDED)

#: After these, "auto" goes on to the next solver
_GOES_ON = (Status.INACCURATE, Status.FAILED)


def fit(
    scene: Scene,
    formulation: str | Path | Formulation = "eq10",
    *,
    solver: str = "auto",
    tolerance: float = 1e-6,
    time_limit: float | None = None,
    **options: Any,
) -> Solution:
    """Fit a field to a scene.

    Args:
        scene: Patient, probe and measurements.
        formulation: A name, a path to a file with ``build``, or a Formulation.
        solver: A solver's name, or "auto".
        tolerance: Largest relative KKT residual of a solution [–].
        time_limit: Most seconds the solver may take, each time it is called [s].
        options: The formulation's own (``force_weight``, ``torque_weight``, …).

    Returns: The solution; its ``field`` is there only when its residuals, computed
    here, hold to the tolerance. Parameters beside the field come with standard errors,
    see `ttus_opt.fitting.identification`; those that the data do not bear have their
    neutral value, for which the field is fitted, and are named.

    Raises:
        InputError: Unknown formulation, option or solver, or a solver that cannot
            take the problem.
        SolverUnavailableError: The solver's package is not installed.
    """
    start = time.perf_counter()
    declared = shelf.load(formulation, scene, **options)
    if declared.scene is not scene:
        raise InputError("the formulation speaks of another scene: build it anew")
    request = Request(tolerance, time_limit)
    doubts = declared.unborne()
    declared = declared.without(doubts)
    if declared.search is None:
        return _told(Found(declared, {}), doubts, solver, request, start)
    loose = replace(request, tolerance=max(SEARCH_TOLERANCE, request.tolerance))
    found = searched(
        declared.search, Again(solver, loose), Again(solver, request), doubts
    )
    spent = time.perf_counter() - start
    found = replace(found, formulation=found.formulation.named(declared.name))
    return _told(found, doubts, solver, request, None, spent)


def _told(
    found: Found,
    doubts: Mapping[str, str],
    solver: str,
    request: Request,
    started: float | None,
    spent: float = 0.0,
) -> Solution:
    """The fit of what a search found, until the data bear every parameter in it.

    Args:
        found: The formulation, and estimates of what was searched for.
        doubts: Why a parameter is not identified, by name.
        solver: A solver's name, or "auto".
        request: Tolerance and time limit.
        started: When declaring it began; None where a search came between.
        spent: On the search [s].
    """
    declared = found.formulation
    known = dict(doubts)
    known |= {name: e.doubt for name, e in found.estimates.items() if e.doubt}
    estimates = {n: e for n, e in found.estimates.items() if n not in known}
    n_searched = len(estimates)
    solution = Fitter(declared, solver=solver, request=request, started=started).solve()
    while True:
        begun = time.perf_counter()
        estimates |= fitted_estimates(declared, solution, request, n_searched)
        spent += time.perf_counter() - begun
        more = {n: e.doubt for n, e in estimates.items() if e.doubt}
        if not any(estimates[name].value for name in more):
            # none, or what is in doubt is neutral already, held there by its bound
            known |= more
            break
        declared = declared.without(more)
        known = declared.unborne() | known | more
        estimates = {n: e for n, e in estimates.items() if n not in known}
        solution = Fitter(declared, solver=solver, request=request).solve()
    if spent and (estimates or found.estimates or found.trouble):
        timings = replace(solution.timings, search=spent)
        solution = replace(solution, timings=timings)
    return with_estimates(solution, declared.scene, estimates, known, found.trouble)


class Again:
    """Fits of one formulation after the other by one solver that keeps its state."""

    def __init__(self, solver: str, request: Request) -> None:
        self._solver, self._request = solver, request
        self._fitter: Fitter | None = None

    def __call__(self, declared: Formulation) -> Solution:
        """Fit."""
        if self._fitter is None:
            self._fitter = Fitter(declared, solver=self._solver, request=self._request)
        else:
            self._fitter.update(declared)
        return self._fitter.solve()


class Fitter:
    """A formulation with a solver loaded, for solving again with other data.

    ``update(declared.with_weights(force=1e-2))`` and ``solve()`` give the solution for
    other weights from what the solver has kept.

    Args:
        declared: The formulation.
        solver: A solver's name, or "auto".
        request: Tolerance and time limit.
        started: When declaring it began, of `time.perf_counter` [s].
    """

    def __init__(
        self,
        declared: Formulation,
        *,
        solver: str = "auto",
        request: Request | None = None,
        started: float | None = None,
    ) -> None:
        """Compile the formulation and prepare the solver.

        Raises:
            InputError: Unknown solver, or one that cannot take the problem.
            SolverUnavailableError: The solver's package is not installed.
        """
        start = time.perf_counter() if started is None else started
        self._request = request or Request()
        self._declared = declared
        self._reduction = reduce(declared.compile())
        self._backend, *self._others = registry.candidates(
            solver, self._reduction.program
        )
        compiled = time.perf_counter()
        self._prepared = self._backend.prepare(self._reduction.program, self._request)
        self._assembly = declared.scene.seconds + compiled - start
        self._setup = time.perf_counter() - compiled
        self._first: float | None = None
        self._taken_in = 0.0

    @property
    def solver_name(self) -> str:
        """The solver that was chosen."""
        return self._backend.name

    def update(self, declared: Formulation) -> None:
        """Take other weights or data; the solver keeps what it can."""
        start = time.perf_counter()
        self._declared = declared
        self._reduction = reduce(declared.compile())
        self._prepared.update(self._reduction.program)
        self._taken_in = time.perf_counter() - start

    def solve(self) -> Solution:
        """Solve what is loaded and verify the answer.

        With "auto" a solver whose answer does not hold gives way to the next one, now
        and for later solves; `Solution.attempts` tells.
        """
        solution = self._solved()
        attempts: list[Attempt] = []
        best = solution
        while solution.status in _GOES_ON and self._others:
            attempts.append(Attempt.of(solution))
            self._take_next()
            solution = self._solved()
            best = _better(best, solution)
        if not attempts:
            return solution
        if best is not solution:
            attempts.append(Attempt.of(solution))
            attempts = [a for a in attempts if a.solver != best.solver]
        return replace(best, attempts=tuple(attempts))

    def _take_next(self) -> None:
        start = time.perf_counter()
        self._backend = self._others.pop(0)
        self._prepared = self._backend.prepare(self._reduction.program, self._request)
        self._setup += time.perf_counter() - start
        self._first = None

    def _solved(self) -> Solution:
        """What the solver in charge answers, verified."""
        start = time.perf_counter()
        candidate = self._prepared.solve()
        spent = time.perf_counter() - start
        again = None
        if self._first is None:
            self._first = spent
        else:
            again = self._taken_in + spent
        self._taken_in = 0.0
        timings = Timings(self._assembly, self._setup, self._first, again)
        return judged(
            self._declared,
            self._reduction,
            self._backend.name,
            candidate,
            self._request,
            timings,
        )


def judged(
    declared: Formulation,
    reduction: Reduction,
    solver: str,
    candidate: Candidate,
    request: Request,
    timings: Timings,
) -> Solution:
    """Turn a candidate into a solution by its own residuals.

    Args:
        declared: The formulation.
        reduction: Its program, and the one the solver was given.
        solver: The solver's name.
        candidate: The solver's answer.
        request: Tolerance and time limit.
        timings: Where the time went.

    Returns:
        The solution of the original program.
    """
    scene, program = declared.scene, reduction.original
    x, duals = candidate.x, candidate.duals
    if x is not None:
        point = reduction.restore(x, duals)
        x, duals = point.x, point.duals
    kkt = None
    if x is not None:
        kkt = kkt_residuals(program, x, duals, tolerance=request.tolerance)
    verdict = _verdict(candidate, reduction, kkt, request)
    status, conflict = verdict.status, verdict.conflict
    parameters = dict(scene.parameters)
    if x is not None and np.isfinite(x).all():
        parameters = declared.parameters(program.split(x))
    costs = {}
    if x is not None:
        with np.errstate(over="ignore", invalid="ignore"):  # of an answer that is none
            costs = program.costs(x)
    verified = None
    if status is Status.SOLVED and x is not None:
        verified = PotentialField(
            scene.voxmap,
            scene.voxmap.grid.unflatten(x[program.variables["p"]]).copy(),
            scene.sampling,
            parameters,
            {"formulation": repr(declared), "solver": solver},
        )
    return Solution(
        status=status,
        solver=solver,
        formulation=declared.name,
        kkt=kkt,
        objective=float("nan") if not costs else sum(costs.values()),
        costs=costs,
        slacks={} if x is None else _slacks(program, x),
        duals=duals,
        timings=timings,
        iterations=candidate.iterations,
        parameters=parameters,
        program=program,
        candidate=x,
        detail="; ".join(filter(None, (candidate.detail, verdict.remark))),
        verified_field=verified,
        conflict=conflict,
    )


@dataclass(frozen=True)
class _Verdict:
    """A status, the constraints to blame, and what there is to say of a claim."""

    status: Status
    conflict: tuple[str, ...] = ()
    remark: str = ""


def _verdict(
    candidate: Candidate, reduction: Reduction, kkt: KKT | None, request: Request
) -> _Verdict:
    """What comes of an answer: decided by residuals and certificates, not by claims."""
    claim = candidate.claim
    holds = kkt is not None and kkt.worst_relative <= request.tolerance
    if kkt is not None and holds and (kkt.is_bound or claim not in _DOUBTS):
        return _Verdict(Status.SOLVED)
    broken = kkt is None or kkt.primal_relative > request.tolerance
    if claim is Claim.INFEASIBLE or (claim is not Claim.TIME_LIMIT and broken):
        conflict = _conflict(reduction.original, candidate, request)
        if conflict:
            return _Verdict(Status.INFEASIBLE, conflict)
    if claim is Claim.UNBOUNDED:
        seconds = request.time_limit or CONFLICT_SECONDS
        if falling_ray(reduction.program, time_limit=seconds) is not None:
            return _Verdict(Status.UNBOUNDED)
    if claim is Claim.TIME_LIMIT:
        return _Verdict(Status.TIME_LIMIT)
    remark = ""
    if claim in (Claim.INFEASIBLE, Claim.UNBOUNDED):
        remark = f'"{claim.value}" is the solver\'s word, without a proof that holds'
    elif holds:
        remark = "the residuals hold but the solver doubts its answer"
    return _Verdict(Status.FAILED if kkt is None else Status.INACCURATE, (), remark)


def _conflict(
    program: Program, candidate: Candidate, request: Request
) -> tuple[str, ...]:
    """Names of constraints that are proved to contradict each other."""
    if program.is_unconstrained:
        return ()
    claimed = candidate.duals if candidate.x is None else None
    seconds = request.time_limit or CONFLICT_SECONDS
    return conflicting(program, claimed=claimed, time_limit=seconds)


def _better(one: Solution, other: Solution) -> Solution:
    """The one that is solved, or whose residuals are smaller."""
    if other.status is Status.SOLVED or one.kkt is None:
        return other
    if other.kkt is None or one.kkt.worst_relative <= other.kkt.worst_relative:
        return one
    return other


def _slacks(program: Program, x: Array) -> dict[str, Array]:
    """Distance of every constraint row to its nearer limit, negative when broken."""
    slacks = {member.name: member.slack(x) for member in program.constraints}
    return slacks | {member.name: member.slack(x) for member in program.bounds}
