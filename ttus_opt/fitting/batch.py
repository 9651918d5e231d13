"""Fit: formulation and solver in, verified solution out."""

from __future__ import annotations

import functools
import logging
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arguments import expect
from ttus_opt.core.compiled import Stopwatch
from ttus_opt.fitting.parameters.fitted_parameters import fitted_estimates
from ttus_opt.fitting.parameters.identification import (
    warn_of_untold_friction,
    with_estimates,
)
from ttus_opt.fitting.parameters.parameter_search import SearchResult, search_parameters
from ttus_opt.fitting.verdict import Guarded, checked_candidate
from ttus_opt.fitting.verdict import judged as judged
from ttus_opt.problem.compression import Compression
from ttus_opt.problem.formulation import DEFAULT, Formulation, load
from ttus_opt.problem.reduction import Reduction, reduce
from ttus_opt.problem.solution import Attempt, Solution, Status, Timings
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Request, Solver

if TYPE_CHECKING:
    from ttus_opt.fitting.weights.weight_choice import Word

LOG = logging.getLogger(__name__)

#: KKT tolerance of the fits during a search; the final fit has the requested one
SEARCH_TOLERANCE = 1e-4

#: Statuses after which "auto" tries the next solver
_TRY_NEXT = (Status.INACCURATE, Status.FAILED)


def fit(
    scene: Scene,
    formulation: str | Path | Formulation | None = None,
    *,
    solver: str | Path | Solver = "auto",
    tolerance: float = 1e-6,
    time_limit: float | None = None,
    weights: Word | None = None,
    **options: Any,
) -> Solution:
    """Fit a field to a scene.

    Args:
        scene: Patient, probe and measurements.
        formulation: A name, a path to a file with ``build``, or a Formulation; None
            for eq. 10.
        solver: A solver's name, "auto", the path of a file with ``SOLVERS``, or a
            `ttus_opt.solvers.base.Solver`.
        tolerance: Largest relative KKT residual of a solution [–].
        time_limit: Most time of every call of the solver [s].
        weights: "auto" chooses weights and boundary scale by how places left out are
            predicted (`ttus_opt.tune`), those of a formulation of your own too.
            Recordings of one place determine none: its own weights are used with a
            `TtusWarning`. Without a formulation it takes the default model, that of
            ``ttus-opt fit``: a depth map, sampled by contact size, with drag where the
            recordings show it (`fitting.weights.weight_choice.default_model`). "own" or
            None takes the formulation's own weights.
        options: Options of the formulation (``force_weight``, ``torque_weight``, …).

    Returns: The solution. It has a ``field`` only when its residuals, computed here,
    meet the tolerance. Parameters beside the field have standard errors
    (`fitting.parameters.identification`); those that the data do not determine are
    named and have their neutral value, with which the field is fitted.

    Raises:
        InputError: Unknown formulation, option or solver, or a solver that cannot
            take the problem.
        SolverUnavailableError: The solver's package is not installed.
    """
    expect(scene, Scene, "the scene")
    usual = DEFAULT if formulation is None else formulation
    if weights not in (None, "own"):
        from ttus_opt.fitting.weights.weight_choice import choice_of

        watch = Stopwatch()
        choice = choice_of(weights, scene, formulation, options)
        choosing = watch.seconds
        solution = fit(
            choice.scene,
            choice.formulation,
            solver=solver,
            tolerance=tolerance,
            time_limit=time_limit,
        )
        spent = (solution.timings.search or 0.0) + choosing
        timings = replace(solution.timings, search=spent)
        return replace(solution, timings=timings, chosen=choice.lines)
    watch = Stopwatch()
    declared = load(usual, scene, **options)
    request = Request(tolerance, time_limit)
    reasons = declared.not_identifiable()
    warn_of_untold_friction(declared, "0 is used")
    declared = declared.with_neutral(reasons)
    if declared.search is None:
        unsearched = SearchResult(declared, {})
        return _fit_identified(unsearched, reasons, solver, request, watch, False)
    loose = replace(request, tolerance=max(SEARCH_TOLERANCE, request.tolerance))
    fits = RepeatedFit(solver, loose), RepeatedFit(solver, request)
    result = search_parameters(declared.search, *fits, reasons)
    result = replace(result, formulation=result.formulation.named(declared.name))
    return _fit_identified(result, reasons, solver, request, watch, True)


def _fit_identified(
    search: SearchResult,
    reasons: Mapping[str, str],
    solver: str | Path | Solver,
    request: Request,
    watch: Stopwatch,
    searched: bool,
) -> Solution:
    """Fit, setting parameters to neutral until the data determine all others.

    Args:
        search: The formulation, and estimates of the searched parameters.
        reasons: Why a parameter is not identified, by name.
        solver: As in `fit`.
        request: Tolerance and time limit.
        watch: Started with the declaration, and the search.
        searched: Whether there was one.
    """
    declared = search.formulation
    known = dict(reasons)
    known |= {name: e.reason for name, e in search.estimates.items() if e.reason}
    estimates = {n: e for n, e in search.estimates.items() if n not in known}
    n_searched = len(estimates)
    spent, compiled = (watch.seconds, watch.compile) if searched else (0.0, 0.0)
    begun = None if searched else watch
    fitter = Fitter(declared, solver=solver, request=request, watch=begun)
    solution = fitter.solve()
    while True:
        watch = Stopwatch()
        estimates |= fitted_estimates(
            declared, solution, request, n_searched, fitter.solver
        )
        spent += watch.seconds
        compiled += watch.compile
        more = {n: e.reason for n, e in estimates.items() if e.reason}
        if not any(estimates[name].value for name in more):
            # all are identified, or have their neutral value already
            known |= more
            break
        declared = declared.with_neutral(more)
        known = declared.not_identifiable() | known | more
        estimates = {n: e for n, e in estimates.items() if n not in known}
        fitter = Fitter(declared, solver=solver, request=request)
        solution = fitter.solve()
    if spent and (estimates or search.estimates or search.trouble):
        timings = solution.timings
        timings = replace(timings, search=spent, compile=timings.compile + compiled)
        solution = replace(solution, timings=timings)
    return with_estimates(solution, declared.scene, estimates, known, search.trouble)


class RepeatedFit:
    """Fits a sequence of formulations by one solver that keeps its state."""

    def __init__(self, solver: str | Path | Solver, request: Request) -> None:
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
    """A formulation with a solver loaded, for repeated solves with other data.

    ``update(declared.with_weights(force=1e-2))`` and ``solve()`` solve for other
    weights, reusing the solver's state.

    Args:
        declared: The formulation.
        solver: As in `fit`.
        request: Tolerance and time limit.
        watch: Started with the declaration.
    """

    def __init__(
        self,
        declared: Formulation,
        *,
        solver: str | Path | Solver = "auto",
        request: Request | None = None,
        watch: Stopwatch | None = None,
    ) -> None:
        """Compile the formulation and prepare the solver.

        Raises:
            InputError: Unknown solver, or one that cannot take the problem.
            SolverUnavailableError: The solver's package is not installed.
        """
        watch = watch or Stopwatch()
        self._request = request or Request()
        self._declared = declared
        self._compression = Compression()
        self._reduction = self._reduced()
        self._backend, *self._others = registry.candidates(
            solver, self._reduction.program
        )
        self._assembly = declared.scene.seconds + watch.seconds
        others = ", ".join(s.name for s in self._others) or "no other"
        n = self._reduction.program.n_variables
        LOG.info(
            "%s: %d unknowns, by %s, then %s",
            declared.name,
            n,
            self._backend.name,
            others,
        )
        self._compile = declared.scene.compile_seconds + watch.compile
        watch = Stopwatch()
        self._prepared = Guarded(self._backend, self._reduction.program, self._request)
        self._setup = watch.seconds
        self._compile += watch.compile
        self._first: float | None = None
        self._taken_in = 0.0

    def __repr__(self) -> str:
        return f"<Fitter by {self.solver_name} of {self._declared!r}>"

    @property
    def solver(self) -> Solver:
        """The chosen solver."""
        return self._backend

    @property
    def solver_name(self) -> str:
        """Its name."""
        return self._backend.name

    def update(self, declared: Formulation) -> None:
        """Take other weights or data, keeping the solver's state."""
        watch = Stopwatch()
        self._declared = declared
        self._reduction = self._reduced()
        self._prepared.update(self._reduction.program)
        self._taken_in = watch.seconds
        self._compile += watch.compile

    def solve(self) -> Solution:
        """Solve and verify.

        With "auto", a solver whose answer fails its check is replaced by the next one,
        for later solves too; `Solution.attempts` lists them.
        """
        answers = [self._solved()]
        while answers[-1].status in _TRY_NEXT and self._others:
            self._take_next()
            answers.append(self._solved())
        best = functools.reduce(_better, answers)
        attempts = tuple(Attempt.of(one) for one in answers if one is not best)
        return replace(best, attempts=attempts) if attempts else best

    def _reduced(self) -> Reduction:
        """The program for the solver, and the one for the verdict."""
        reduction = reduce(self._declared.compile())
        return replace(reduction, program=self._compression(reduction.program))

    def _take_next(self) -> None:
        watch = Stopwatch()
        self._backend = self._others.pop(0)
        self._prepared = Guarded(self._backend, self._reduction.program, self._request)
        self._setup += watch.seconds
        self._compile += watch.compile
        self._first = None

    def _solved(self) -> Solution:
        """Solve with the current solver and verify."""
        watch = Stopwatch()
        candidate = checked_candidate(
            self._prepared.solve(), self._reduction.program, self._backend.name
        )
        spent = watch.seconds
        self._compile += watch.compile
        again = None
        if self._first is None:
            self._first = spent
        else:
            again = self._taken_in + spent
        self._taken_in = 0.0
        timings = Timings(
            self._assembly, self._setup, self._first, again, compile=self._compile
        )
        solution = judged(
            self._declared,
            self._reduction,
            self._backend.name,
            candidate,
            self._request,
            timings,
        )
        LOG.info(
            "%s: %s after %.2f s, %s iterations, KKT %.1e",
            self._backend.name,
            solution.status.name,
            spent,
            solution.iterations,
            math.nan if solution.kkt is None else solution.kkt.worst_relative,
        )
        return replace(solution, compressed=self._compression.rows)


def _better(one: Solution, other: Solution) -> Solution:
    """The one that is solved, or whose residuals are smaller."""
    if other.status is Status.SOLVED or one.kkt is None:
        return other
    if other.kkt is None or one.kkt.worst_relative <= other.kkt.worst_relative:
        return one
    return other
