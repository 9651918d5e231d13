"""The structured solver: eq. 10 without ever forming Q (docs/method.md, section 10).

The dual system is solved by conjugate gradients in a recycled subspace, with an
approximate Schur preconditioner (`ttus_opt.solvers.dual`); L⁻¹ is a multigrid
(`ttus_opt.multigrid`). Where the field has bounds or must grow along spokes, or a
second field may be at most a share of it, a primal-dual active set goes from working
set to working set. What a new solve costs, in solves with L or Lᵀ:

    new measured values     2 for p, and 2 per direction the old ones lack
    new boundary values     1 for p₀ more
    new weights             the same: kept directions are made conjugate again
    another trajectory      all directions anew, the multigrid is kept
    any, with limits        starts from the last working set, with new directions
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.laplace.system import RTOL
from ttus_opt.problem.kkt import Duals, kkt_residuals
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Prepared,
    Request,
    Solver,
)
from ttus_opt.solvers.dual.active_set import ActiveSetIteration, LimitedProblem
from ttus_opt.solvers.dual.data import (
    DualData,
    duals_without_limits,
    hard_values,
    has_all_rows,
    laplace_prior,
    row_scale,
)
from ttus_opt.solvers.dual.field_pair import FieldPair, second_field
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.linear_parameters import LinearParameters
from ttus_opt.solvers.dual.options import Accuracy, DualOptions
from ttus_opt.solvers.dual.primal_dual_active_set import primal_dual_active_set
from ttus_opt.solvers.dual.solver import DualSolver
from ttus_opt.solvers.dual.subproblem import LimitedField
from ttus_opt.solvers.dual.working_set import WorkingSet

#: Most unknowns beside the field: each costs an approximate dual solve
MOST = 64


class Structured(Solver):
    """Conjugate gradients on the dual system, L⁻¹ by multigrid; active sets.

    Attributes:
        options: Of the method.
    """

    name = "structured"
    summary = "never forms Q: multigrid, conjugate gradients in the dual, active sets"
    capabilities = Capabilities(
        inequalities=True,
        equalities=True,
        any_terms=False,
        keeps="the multigrid, all directions while the rows stay, the working set",
    )

    def __init__(self, options: DualOptions | None = None) -> None:
        self.options = options or DualOptions()

    def refusal(self, program: Program) -> str:
        """A Laplace term, measured rows, limits as `SpokeLimits` or `FieldPair`."""
        base = super().refusal(program)
        if base:
            return base
        prior = laplace_prior(program)
        if prior is None or prior.weight == 0.0:
            return "it needs a Laplace term"
        if not has_all_rows(prior) and hard_values(program) is None:
            return f"it takes {prior.name} with hard boundary values only"
        bent = [t.name for t in program.terms if not t.is_squares]
        if bent:
            return f"it takes sums of squares only, {bent[0]} is none"
        if second_field(program) is not None:
            return self._refusal_of_pair(program)
        free = program.laplace.free
        others = program.n_variables - len(free)
        if others > MOST:
            return f"it takes {MOST} unknowns beside the field, these are {others}"
        try:
            limits = SpokeLimits.of(program)
        except ValueError as error:
            return f"it takes bounds and growth along spokes: {error}"
        scale = row_scale(prior)
        if limits.binding and scale is not None and (scale[free] != 1.0).any():
            return f"it takes {prior.name} without bounds only"
        if limits.binding and others:
            return "it takes no limits of the field where there are other unknowns"
        return ""

    def _refusal_of_pair(self, program: Program) -> str:
        """Two fields with a Laplace term each, bounds, one at most a share."""
        try:
            FieldPair.of(program)
        except ValueError as error:
            return f"of two fields it takes bounds and a largest share: {error}"
        return ""

    def suits(self, program: Program) -> bool:
        """Few measured rows: a term over all voxels makes the dual as large as p."""
        second = second_field(program)
        priors = [laplace_prior(program), second[1] if second else None]
        rows = sum(
            len(t.target) for t in program.terms if not any(t is k for k in priors)
        )
        return rows <= program.n_variables / 2

    def prepare(self, program: Program, request: Request) -> Prepared:
        """Set up the multigrid and the dual system."""
        self.require(program)
        if second_field(program) is not None:
            return _LoadedPair(program, request, self.options)
        return _Loaded(program, request, self.options)


class _Limited(Prepared):
    """A program, its last working set, and what is asked of the solver."""

    _program: Program

    def __init__(
        self, program: Program, request: Request, options: DualOptions
    ) -> None:
        self._request, self._options = request, options
        self._last: tuple[Array, WorkingSet] | None = None
        self.update(program)

    def _contradiction(self, limits: SpokeLimits) -> Candidate | None:
        """What to answer where limits leave nothing."""
        worst = limits.contradiction()
        if worst <= self._request.tolerance * _largest_limit(limits):
            return None
        detail = f"limits along a spoke contradict each other by {worst:.2g}"
        return Candidate(
            None, self._proof(limits), claim=Claim.INFEASIBLE, detail=detail
        )

    def _proof(self, limits: SpokeLimits) -> Duals:
        """Multipliers that prove a contradiction; none where they are not known."""
        return Duals()

    def _tightened(self, attempt: Callable[[Accuracy], Candidate]) -> Candidate:
        """Try until the answer holds, each time more exactly; the best answer.

        Args:
            attempt: Solves to an accuracy of the dual.
        """
        limit = self._request.time_limit
        deadline = None if limit is None else time.perf_counter() + limit
        rtol = max(self._request.tolerance * self._options.dual_margin, RTOL)
        steps, best, least = 0, Candidate(None), np.inf
        for _ in range(self._options.tightenings):
            candidate = attempt(Accuracy(rtol, deadline=deadline))
            assert candidate.x is not None
            steps += candidate.iterations
            kkt = kkt_residuals(
                self._program,
                candidate.x,
                candidate.duals,
                tolerance=self._request.tolerance,
            )
            gained = kkt.worst_relative < least
            if gained or best.x is None:
                best, least = candidate, kkt.worst_relative
            if least <= self._request.tolerance or not gained:
                break
            if candidate.claim is Claim.TIME_LIMIT:
                break
            rtol *= self._options.tightening
        return replace(best, iterations=steps)

    def _within(
        self, problem: LimitedProblem, limits: SpokeLimits, accuracy: Accuracy
    ) -> ActiveSetIteration:
        """The best field within limits, from the last working set on."""
        answer = primal_dual_active_set(
            problem, limits, self._last, self._request.tolerance, accuracy
        )
        if answer.settled:
            self._last = answer.p, answer.active
        return answer


def _candidate(answer: ActiveSetIteration, x: Array, duals: Duals) -> Candidate:
    """An iteration's end as a solver's answer."""
    claim = Claim.TIME_LIMIT if answer.late else Claim.GAVE_UP
    return Candidate(
        x,
        duals,
        answer.steps,
        Claim.DONE if answer.settled else claim,
        f"{answer.sets} working sets, {answer.active.count} active limits",
    )


class _LoadedPair(_Limited):
    def update(self, program: Program) -> None:
        """Take other data; the multigrid and the last working set are kept."""
        self._program, self._pair = program, FieldPair.of(program, self._options)
        program.laplace.multigrid  # noqa: B018  (built here, in the set-up's time)

    def solve(self) -> Candidate:
        """Solve the duals of working sets."""
        return self._contradiction(self._pair.limits) or self._tightened(self._limited)

    def _limited(self, accuracy: Accuracy) -> Candidate:
        pair = self._pair
        found = self._within(pair, pair.limits, accuracy)
        x = pair.variables(found.p)
        return _candidate(found, x, pair.duals(x, found.multipliers))


class _Loaded(_Limited):
    _solver: DualSolver | None = None

    def update(self, program: Program) -> None:
        """Take other data; keeps what the module's docstring says."""
        self._program = program
        self._data = DualData.of(program)
        self._limits = SpokeLimits.of(program)
        # built here, in the set-up's time
        self._data.system.laplace.multigrid  # noqa: B018
        system, bounds = (
            self._data.system,
            (b[len(self._data.b) :] for b in program.box),
        )
        beside = LinearParameters(self._data.columns, *bounds)
        if self._solver is None or not system.same_rows(self._solver.system):
            self._solver = DualSolver(system, beside, self._options)
        else:
            self._solver.adopt(system, beside)

    def solve(self) -> Candidate:
        """Solve the dual, or where there are limits the duals of working sets."""
        if self._limits.binding:
            impossible = self._contradiction(self._limits)
            return impossible or self._tightened(self._limited)
        return self._tightened(self._unlimited)

    def _proof(self, limits: SpokeLimits) -> Duals:
        return limits.proof_of_contradiction() or Duals()

    def _limited(self, accuracy: Accuracy) -> Candidate:
        """The field within its limits."""
        assert self._solver is not None
        limits = self._limits
        problem = LimitedField(
            self._program, limits, self._data, self._solver, self._options
        )
        found = self._within(problem, limits, accuracy)
        return _candidate(found, found.p, found.multipliers.duals(limits))

    def _unlimited(self, accuracy: Accuracy) -> Candidate:
        """The field without limits, and the unknowns beside it."""
        assert self._solver is not None
        answer = self._solver.solve(self._data.b, self._data.t, accuracy)
        x = np.concatenate([answer.p, answer.c])
        claim = Claim.TIME_LIMIT if answer.late else Claim.DONE
        return Candidate(x, duals_without_limits(self._program, x), answer.steps, claim)


def _largest_limit(limits: SpokeLimits) -> float:
    """The largest finite limit, 1 where all are zero."""
    finite = [
        np.abs(values[np.isfinite(values)]).max(initial=0.0)
        for values in (limits.lower, limits.upper, limits.least)
    ]
    return float(max(finite)) or 1.0


SOLVERS = [Structured()]
