"""The structured solver: eq. 10 without ever forming Q (design §3, structures a-d).

The dual system (`dual_system`) is solved by conjugate directions that are all kept
(`conjugate_directions`), preconditioned by a rough dual (`rough_dual`); L⁻¹ is a
multigrid (`ttus_opt.multigrid`). What a new solve costs, in solves with L or Lᵀ:

    new measured values     2 for p, and 2 per direction the old ones lack
    new boundary values     1 for p₀ more
    new weights             the same: kept directions are made conjugate again
    another trajectory      all directions anew, the multigrid is kept
"""

from __future__ import annotations

import time

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.constraints.boundary import HardBoundary
from ttus_opt.problem.kkt import Duals
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Prepared,
    Request,
    Solver,
)
from ttus_opt.solvers.dual_solver import DualSolver
from ttus_opt.solvers.dual_system import DualSystem
from ttus_opt.terms.base import Penalty

Array = NDArray[np.float64]

#: How far below the KKT tolerance the dual system is solved, and its floor
MARGIN, FLOOR = 1e-2, 1e-12


class Structured(Solver):
    """Kept conjugate directions on the dual system, L⁻¹ by multigrid."""

    name = "structured"
    summary = "never forms Q: multigrid solves with L, conjugate directions in the dual"
    capabilities = Capabilities(
        inequalities=False,
        equalities=True,
        any_terms=False,
        keeps="the multigrid, and every conjugate direction while the rows stay",
    )

    def refusal(self, program: Program) -> str:
        """Only a Laplace term, measured rows and hard Dirichlet values."""
        base = super().refusal(program)
        if base:
            return base
        prior = _prior(program)
        if prior is None or prior.weight == 0.0:
            return "it needs a Laplace term"
        if prior.laplace_scale is not None and not program.constraints:
            return f"it takes {prior.name} with hard boundary values only"
        bent = [t.name for t in program.terms if t.penalty is not Penalty.SQUARES]
        if bent:
            return f"it takes sums of squares only, {bent[0]} is none"
        if set(program.variables) != {"p"}:
            return "it knows no variables beside the field"
        if any(c.name != HardBoundary.name for c in program.constraints):
            return "it takes no constraint beside hard boundary values"
        return ""

    def suits(self, program: Program) -> bool:
        """Few measured rows: a term over all voxels makes the dual as large as p."""
        rows = sum(len(t.target) for t in program.terms if t is not _prior(program))
        return rows <= program.n_variables / 2

    def prepare(self, program: Program, request: Request) -> Prepared:
        """Set up the multigrid and the dual system."""
        self.require(program)
        return _Loaded(program, request)


class _Loaded(Prepared):
    def __init__(self, program: Program, request: Request) -> None:
        self._request = request
        self._solver: DualSolver | None = None
        self.update(program)

    def update(self, program: Program) -> None:
        """Take other data; keeps what the module's docstring says."""
        prior = _prior(program)
        assert prior is not None
        self._program = program
        self._b = _right_side(program, prior)
        program.laplace.multigrid  # noqa: B018  (built here, in the set-up's time)
        system, self._t = _dual_system(program, prior)
        if self._solver is None or not system.same_rows(self._solver.system):
            self._solver = DualSolver(system)
        elif not np.array_equal(system.root_weights, self._solver.system.root_weights):
            self._solver.adopt(system)

    def solve(self) -> Candidate:
        """Solve the dual system, then one response for the field."""
        limit = self._request.time_limit
        assert self._solver is not None
        answer = self._solver.solve(
            self._b,
            self._t,
            rtol=max(self._request.tolerance * MARGIN, FLOOR),
            deadline=None if limit is None else time.perf_counter() + limit,
        )
        claim = Claim.TIME_LIMIT if answer.late else Claim.DONE
        return Candidate(answer.p, self._duals(answer.p), answer.steps, claim)

    def _duals(self, p: Array) -> Duals:
        """Multipliers of hard Dirichlet values: minus the objective's gradient."""
        if not self._program.constraints:
            return Duals()
        gradient = np.add(*self._program.gradient(p))
        constraint = self._program.constraints[0]
        return Duals({constraint.name: -gradient[~self._program.laplace.free]})


def _prior(program: Program) -> ProgramTerm | None:
    """The Laplace term, or the one whose rows are L's times numbers."""
    scaled = [t for t in program.terms if t.laplace_scale is not None]
    return program.laplace_term or (scaled[0] if scaled else None)


def _right_side(program: Program, prior: ProgramTerm) -> Array:
    """Vector b of L p = b, from scaled free rows and hard boundary values."""
    free = program.laplace.free
    if prior.laplace_scale is None:
        b = prior.target
        if program.constraints:
            b = b.copy()
            b[~free] = program.constraints[0].lower
        return b
    b = np.empty(len(free))
    b[free] = prior.target / prior.laplace_scale[free]
    b[~free] = program.constraints[0].lower
    return b


def _dual_system(program: Program, prior: ProgramTerm) -> tuple[DualSystem, Array]:
    """The dual system of a program and its weighted targets."""
    measured = [t for t in program.terms if t is not prior and t.weight > 0.0]
    softness = np.ones(program.n_variables)
    if prior.laplace_scale is not None:
        softness /= prior.laplace_scale**2
    if program.constraints:
        softness[~program.laplace.free] = 0.0
    if not measured:
        rows = sp.csr_array((0, program.n_variables))
        return DualSystem(program.laplace, softness, rows, np.zeros(0)), np.zeros(0)
    roots = np.concatenate(
        [np.full(len(t.target), np.sqrt(t.weight / prior.weight)) for t in measured]
    )
    rows = sp.csr_array(sp.vstack([t.matrix for t in measured], format="csr"))
    targets = roots * np.concatenate([t.target for t in measured])
    return DualSystem(program.laplace, softness, rows, roots), targets


SOLVERS = [Structured()]
