"""The structured solver: eq. 10 without forming Q (docs/method/solver.md, section 10).

The dual system is solved by conjugate gradients in a recycled subspace, with an
approximate Schur preconditioner (`solvers.dual`); L⁻¹ is a multigrid
(`laplace.multigrid`). Bounds, growth along spokes, and a second field that is at most
a share of the first are handled by a primal-dual active-set method. Solves with L or Lᵀ
that a new solve takes:

    new measured values     2 for p, and 2 per new direction
    new boundary values     1 more, for p₀
    new weights             the same: kept directions are made conjugate again
    another trajectory      new directions, the multigrid is kept
    any, with limits        starts from the last working set, with new directions
"""

from __future__ import annotations

import numpy as np

from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Solver,
)
from ttus_opt.solvers.dual.data import (
    DualData,
    duals_without_limits,
    refusal_of_terms,
    refusal_of_unknowns,
    second_field,
)
from ttus_opt.solvers.dual.field_pair import FieldPair
from ttus_opt.solvers.dual.limited import Limited
from ttus_opt.solvers.dual.limits import SpokeLimits, refusal_of_limits
from ttus_opt.solvers.dual.linear_parameters import LinearParameters
from ttus_opt.solvers.dual.solver import Accuracy, DualSolver
from ttus_opt.solvers.dual.subproblem import LimitedField
from ttus_opt.solvers.primal.split import wide_terms
from ttus_opt.solvers.sizes import Sizes


class _Loaded(Limited):
    _solver: DualSolver | None = None

    def _load(self, program: Program) -> None:
        """Load other data; the module's docstring lists what is kept."""
        if second_field(program) is not None:
            self._problem = FieldPair.of(program)
            program.laplace.multigrid  # noqa: B018  (counts as set-up)
            return
        self._data = DualData.of(program)
        system = self._data.system
        system.laplace.multigrid  # noqa: B018  (likewise)
        bounds = (b[len(self._data.b) :] for b in program.box)
        beside = LinearParameters(self._data.columns, *bounds)
        if self._solver is None or not system.same_rows(self._solver.system):
            self._solver = DualSolver(system, beside)
        else:
            self._solver.adopt(system, beside)
        limits = SpokeLimits.of(program)
        self._problem = LimitedField(program, limits, self._data, self._solver)

    def _unlimited(self, accuracy: Accuracy) -> Candidate:
        """The field and the unknowns beside it, without limits."""
        if isinstance(self._problem, FieldPair):
            return self._limited(accuracy)
        assert self._solver is not None
        answer = self._solver.solve(self._data.b, self._data.t, accuracy)
        x = np.concatenate([answer.p, answer.c])
        claim = Claim.TIME_LIMIT if answer.late else Claim.DONE
        return Candidate(x, duals_without_limits(self._program, x), answer.steps, claim)


class Structured(Solver):
    """Conjugate gradients on the dual system, L⁻¹ by multigrid; active sets."""

    name = "structured"
    loaded = _Loaded
    summary = "never forms Q: multigrid, conjugate gradients in the dual, active sets"
    capabilities = Capabilities(
        inequalities=True,
        equalities=True,
        any_terms=False,
        keeps="the multigrid, all directions while the rows stay, the working set",
    )

    def refusal(self, program: Program) -> str:
        """Takes eq. 10 with the limits of `SpokeLimits` or `FieldPair`."""
        if base := super().refusal(program):
            return base
        terms = refusal_of_terms(program)
        if terms:
            return terms
        if second_field(program) is None:
            return refusal_of_unknowns(program) or refusal_of_limits(program)
        try:
            FieldPair.of(program)
        except ValueError as error:
            return f"with two fields it takes bounds and a largest share: {error}"
        return ""

    def cost(self, program: Program) -> float:
        """In proportion to the voxels; more with limits, most with a second field."""
        s = Sizes.of(program)
        if second_field(program) is not None:
            return 0.1 + 4e-5 * s.voxels
        harder = 1.0 + 5.0 * min(s.measured / s.voxels, 2.0)
        if wide_terms(program):  # they make the dual as large as the field
            harder = 11.0
        return 0.03 + 2.5e-6 * harder * (6.0 if s.limits else 1.0) * s.voxels


SOLVERS = [Structured()]
