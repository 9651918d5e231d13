"""The structured solver: eq. 10 without ever forming Q (design §3, structures a-d).

The dual system is solved by conjugate directions that are all kept, preconditioned by
a rough dual (`ttus_opt.solvers.dual`); L⁻¹ is a multigrid (`ttus_opt.multigrid`). Where
the field has bounds or must grow along spokes, this is done on one face of the feasible
set after the other. What a new solve costs, in solves with L or Lᵀ:

    new measured values     2 for p, and 2 per direction the old ones lack
    new boundary values     1 for p₀ more
    new weights             the same: kept directions are made conjugate again
    another trajectory      all directions anew, the multigrid is kept
    any, with limits        starts from the last face; its directions are made anew
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from ttus_opt.constraints.boundary import HardBoundary
from ttus_opt.problem.kkt import Duals
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Prepared,
    Request,
    Solver,
)
from ttus_opt.solvers.dual.active_set import search
from ttus_opt.solvers.dual.data import DualData, hard_values, laplace_prior
from ttus_opt.solvers.dual.face import Activity
from ttus_opt.solvers.dual.few_columns import MOST, solve_with_columns
from ttus_opt.solvers.dual.solver import DualSolver
from ttus_opt.solvers.dual.spoke_limits import SpokeLimits
from ttus_opt.terms.base import Penalty

Array = NDArray[np.float64]

#: How far below the KKT tolerance the dual system is solved, and its floor
MARGIN, FLOOR = 1e-2, 1e-12


class Structured(Solver):
    """Kept conjugate directions on the dual system, L⁻¹ by multigrid."""

    name = "structured"
    summary = "never forms Q: multigrid, conjugate directions in the dual, active sets"
    capabilities = Capabilities(
        inequalities=True,
        equalities=True,
        any_terms=False,
        keeps="the multigrid, every direction while the rows stay, the last face",
    )

    def refusal(self, program: Program) -> str:
        """A Laplace term, measured rows, bounds and growth along spokes."""
        base = super().refusal(program)
        if base:
            return base
        prior = laplace_prior(program)
        if prior is None or prior.weight == 0.0:
            return "it needs a Laplace term"
        if prior.laplace_scale is not None and hard_values(program) is None:
            return f"it takes {prior.name} with hard boundary values only"
        bent = [t.name for t in program.terms if t.penalty is not Penalty.SQUARES]
        if bent:
            return f"it takes sums of squares only, {bent[0]} is none"
        others = program.n_variables - len(program.laplace.free)
        if others > MOST:
            return f"it takes {MOST} unknowns beside the field, these are {others}"
        try:
            limits = SpokeLimits.of(program)
        except ValueError as error:
            return f"it takes bounds and growth along spokes: {error}"
        if limits.binding and prior.laplace_scale is not None:
            return f"it takes {prior.name} without bounds only"
        if limits.binding and others:
            return "it takes no limits of the field where there are other unknowns"
        return ""

    def suits(self, program: Program) -> bool:
        """Few measured rows: a term over all voxels makes the dual as large as p."""
        rows = sum(
            len(t.target) for t in program.terms if t is not laplace_prior(program)
        )
        return rows <= program.n_variables / 2

    def prepare(self, program: Program, request: Request) -> Prepared:
        """Set up the multigrid and the dual system."""
        self.require(program)
        return _Loaded(program, request)


class _Loaded(Prepared):
    def __init__(self, program: Program, request: Request) -> None:
        self._request = request
        self._solver: DualSolver | None = None
        self._last: tuple[Array, Activity] | None = None
        self.update(program)

    def update(self, program: Program) -> None:
        """Take other data; keeps what the module's docstring says."""
        self._program = program
        self._data = DualData.of(program)
        self._limits = SpokeLimits.of(program)
        program.laplace.multigrid  # noqa: B018  (built here, in the set-up's time)
        system = self._data.system
        if self._solver is None or not system.same_rows(self._solver.system):
            self._solver = DualSolver(system)
        elif not np.array_equal(system.root_weights, self._solver.system.root_weights):
            self._solver.adopt(system)

    def solve(self) -> Candidate:
        """Solve the dual, or where there are limits the duals of faces."""
        limit = self._request.time_limit
        deadline = None if limit is None else time.perf_counter() + limit
        limits = self._limits
        if limits.binding:
            worst = limits.contradiction()
            if worst > self._request.tolerance * _largest_limit(limits):
                detail = f"limits along a spoke contradict each other by {worst:.2g}"
                return Candidate(None, claim=Claim.INFEASIBLE, detail=detail)
            return self._search(deadline)
        assert self._solver is not None
        bounds = (limit[len(self._data.b) :] for limit in self._program.box)
        answer = solve_with_columns(
            self._solver, self._data, *bounds, rtol=self._rtol, deadline=deadline
        )
        x = np.concatenate([answer.p, answer.c])
        claim = Claim.TIME_LIMIT if answer.late else Claim.DONE
        return Candidate(x, self._duals(x), answer.steps, claim)

    @property
    def _rtol(self) -> float:
        return max(self._request.tolerance * MARGIN, FLOOR)

    def _search(self, deadline: float | None) -> Candidate:
        """Face after face, from the last one of an earlier solve."""
        assert self._solver is not None
        answer = search(
            self._program,
            self._limits,
            self._data,
            self._solver,
            self._last,
            tolerance=self._request.tolerance,
            rtol=self._rtol,
            deadline=deadline,
        )
        duals = self._limits.duals(answer.pull, answer.push)
        detail = f"{answer.faces} faces, {answer.active.count} limits active"
        if answer.settled:
            self._last, claim = (answer.p, answer.active), Claim.DONE
        else:
            claim = Claim.TIME_LIMIT if answer.late else Claim.GAVE_UP
        return Candidate(answer.p, duals, answer.steps, claim, detail)

    def _duals(self, x: Array) -> Duals:
        """Multipliers of given values and of other unknowns' bounds."""
        program, V = self._program, len(self._data.b)
        hard = hard_values(program) is not None
        if not (hard or program.bounds):
            return Duals()
        pull = -np.add(*program.gradient(x))
        rows = {HardBoundary.name: pull[:V][~program.laplace.free]} if hard else {}
        lower, upper = program.box
        z = np.where(x <= lower, np.minimum(pull, 0.0), 0.0)
        z += np.where(x >= upper, np.maximum(pull, 0.0), 0.0)
        z[:V] = 0.0
        return Duals(rows, z if program.bounds else None)


def _largest_limit(limits: SpokeLimits) -> float:
    """The largest finite limit, 1 where all are zero."""
    finite = [
        np.abs(values[np.isfinite(values)]).max(initial=0.0)
        for values in (limits.lower, limits.upper, limits.least)
    ]
    return float(max(finite)) or 1.0


SOLVERS = [Structured()]
