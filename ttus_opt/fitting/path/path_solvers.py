"""Solvers for the points of a path; each point reuses the state of those before."""

from __future__ import annotations

import abc
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.batch import RepeatedFit, fit
from ttus_opt.fitting.verdict import judged
from ttus_opt.fitting.weights.place_left_out import criteria
from ttus_opt.fitting.weights.tuning_rows import BasisRows
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import Reduction
from ttus_opt.problem.solution import Solution, Status, Timings
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Candidate, Claim, Request, Solver
from ttus_opt.solvers.dual.data import DualData, duals_without_limits, root_weights
from ttus_opt.solvers.dual.weight_sweep import WeightSweep

#: Energy norm of the error over that of the objective, in units of the KKT tolerance.
#: The gap is its square, so that fields agree with those of single fits [–]
ENERGY = 10.0

#: Factor on that energy where the KKT residuals do not hold, and how often [–]
TIGHTENING, TIGHTENINGS = 1e-2, 2

#: Most rows and voxels of a common basis: 60 response fields of the latter take 2 GiB
MOST_ROWS, MOST_VOXELS = 50_000, 4_000_000

#: Violation of a limit that counts as rounding, over the largest value [–]
ROUNDING = 1e-12


class PointSolver(abc.ABC):
    """Solves a formulation for one set of weights after the other."""

    #: Whether all points share one basis, so that the ends should be solved first
    common = False

    #: Whether no point gains much from those before it
    independent = False

    @abc.abstractmethod
    def __call__(self, declared: Formulation) -> Solution:
        """Solve for the weights of a formulation, and verify."""

    def criteria(self, declared: Formulation) -> Mapping[str, float]:
        """`place_left_out.CRITERIA` for these weights; none by default."""
        return {}

    def prepare_criteria(self, largest: Formulation) -> None:
        """Compute what `criteria` needs, for weights up to these.

        Raises:
            InputError: The problem has no criteria.
        """
        raise InputError(
            f"no criteria for {largest.name}: they need a problem without limits, with "
            "one field, a Laplace term and measured squares; use held-out recordings"
        )


def point_solver(
    declared: Formulation, solver: str | Path | Solver, request: Request
) -> PointSolver:
    """The cheapest way to solve many points.

    Args:
        declared: The formulation at one of them.
        solver: As in `ttus_opt.fit`.
        request: Tolerance and time limit of each point.

    Raises:
        InputError: Unknown solver, or one that cannot take the problem.
        SolverUnavailableError: The solver's package is not installed.
    """
    if declared.search is None and (program := declared.compile()).is_quadratic:
        first = registry.candidates(solver, program)[0]
        if first.name == "structured" and _suits_sweep(program):
            return _CommonBasis(program, request)
    return _InTurn(solver, request)


def _suits_sweep(program: Program) -> bool:
    """Whether a program for `structured` has one field and few measured rows.

    There must be no other terms beside the Laplace term, and memory for the response
    fields. Limits are allowed: if the minimiser without limits satisfies them, it is
    the minimiser with them (`_keeps_limits`).
    """
    prior, V = program.laplace_prior, len(program.laplace.free)
    if prior is None or program.n_variables != V:
        return False
    rows = sum(len(t.target) for t in program.terms if t is not prior)
    return rows <= min(V // 2, MOST_ROWS) and V <= MOST_VOXELS


def _is_limited(program: Program) -> bool:
    """Whether there are limits other than hard boundary values."""
    return bool(program.bounds) or any(
        constraint is not program.dirichlet for constraint in program.constraints
    )


def _keeps_limits(program: Program, x: Array) -> bool:
    """Whether a point satisfies all limits up to rounding, boundary values aside."""
    least = -ROUNDING * float(np.abs(x).max(initial=0.0))
    slacks = [bound.slack(x) for bound in program.bounds]
    slacks += [c.slack(x) for c in program.constraints if c is not program.dirichlet]
    return all(float(slack.min(initial=0.0)) >= least for slack in slacks)


class _InTurn(RepeatedFit, PointSolver):
    """Any solver, keeping its state from point to point.

    A formulation with a searched parameter takes a fit per point.
    """

    independent = True

    def __call__(self, declared: Formulation) -> Solution:
        if declared.search is None:
            return super().__call__(declared)
        return fit(
            declared.scene,
            declared,
            solver=self._solver,
            tolerance=self._request.tolerance,
            time_limit=self._request.time_limit,
        )


class _CommonBasis(PointSolver):
    """The structured solver's reduced basis.

    A minimiser without limits that satisfies them is that with limits. Other points are
    fitted one by one, each from the working set of the last.
    """

    def __init__(self, program: Program, request: Request) -> None:
        self._request = request
        self.common = not _is_limited(program)
        self._data = DualData.of(program)
        self._sweep = WeightSweep(self._data)
        self._alone = _InTurn("structured", request)
        self._rows: BasisRows | None = None

    def __call__(self, declared: Formulation) -> Solution:
        start = time.perf_counter()
        limit = self._request.time_limit
        deadline = None if limit is None else start + limit
        program = declared.compile()
        rtol, steps = ENERGY * self._request.tolerance, 0
        for _ in range(1 + TIGHTENINGS):
            answer = self._sweep.solve(root_weights(program), rtol, deadline)
            steps += answer.directions
            if not _keeps_limits(program, answer.p):
                break
            late = deadline is not None and time.perf_counter() > deadline
            candidate = Candidate(
                answer.p,
                duals_without_limits(program, answer.p),
                steps,
                Claim.TIME_LIMIT if late and not answer.settled else Claim.DONE,
            )
            spent = time.perf_counter() - start
            solution = judged(
                declared,
                Reduction(program, program),
                "structured",
                candidate,
                self._request,
                Timings(0.0, 0.0, spent),
            )
            if solution.status is not Status.INACCURATE:
                return solution
            rtol *= TIGHTENING
        return self._alone(declared)

    def prepare_criteria(self, largest: Formulation) -> None:
        """Complete the basis and sort the rows."""
        if not self.common:
            raise InputError(
                f"no criteria for {largest.name}: they need a problem without limits; "
                "use held-out recordings"
            )
        frames = len(largest.scene.trajectory)
        terms = {
            term.name: len(term.assembled.target)
            for term in largest.terms
            if term.measures and term.weight > 0.0
        }
        if any(n != 3 * frames for n in terms.values()):
            raise InputError("criteria need terms with three rows per frame")
        informative = self._sweep.informative
        if sum(terms.values()) != len(informative):
            raise InputError("criteria need a Laplace term and measured ones only")
        self._sweep.complete(root_weights(largest.compile()))
        # the first term's rows are forces
        term = np.repeat([int(name != "force") for name in terms], 3 * frames)
        press = np.tile(np.repeat(largest.scene.presses, 3), len(terms))
        target = (self._data.t / self._data.system.root_weights)[informative]
        one = np.ones(len(target))
        base = target - self._sweep.misfit
        own = (target, term[informative], press[informative], one)
        self._rows = BasisRows(self._sweep.images, base, *own)

    def criteria(self, declared: Formulation) -> Mapping[str, float]:
        """Criteria by the basis."""
        if self._rows is None:
            return {}
        root = root_weights(declared.compile())[self._sweep.informative]
        return criteria(replace(self._rows, images=self._sweep.images), root)
