"""Normal equations: any sum of squares beside a Laplace term, never factorised.

Conjugate gradients on H p = d, H = LᵀΩ⁻¹L + Σ w MᵀM + DᵀD
(docs/method/solver-variants.md, section 10.10). The preconditioner is (L - X)ᵀ(L - X)
by multigrid, with X a root of the wide terms (`primal.matching`), and takes the few
rows D through their dual (`primal.preconditioner`). A new solve keeps the multigrid,
the dual's directions and the last solution to start from.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.absorption import CLOSE_ENOUGH
from ttus_opt.problem.verify.kkt import STRICTER
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Solver,
)
from ttus_opt.solvers.dual.active_set import DUAL_MARGIN
from ttus_opt.solvers.dual.data import (
    duals_without_limits,
    refusal_of_terms,
    refusal_of_unknowns,
)
from ttus_opt.solvers.dual.limited import Limited
from ttus_opt.solvers.dual.limits import SpokeLimits, refusal_of_limits
from ttus_opt.solvers.dual.solver import Accuracy
from ttus_opt.solvers.primal.least_squares import (
    Goal,
    LeastSquares,
    Minimum,
    minimise,
    preconditioner,
)
from ttus_opt.solvers.primal.limited_sum import LimitedSum
from ttus_opt.solvers.primal.preconditioner import ConstraintPreconditioner
from ttus_opt.solvers.primal.split import FEW_ROWS, Split, wide_terms
from ttus_opt.solvers.sizes import Sizes

#: Most continuations of a solve until the bound of its gap is small enough
BOUNDS = 4

#: Gap and gradient aimed for, over the tolerance; the gap is small because the final
#: check knows only a bound of it [–]
GAP, GRADIENT = 1e-3, 0.1


class _Loaded(Limited):
    _backend: NormalEquations
    _at: Array | None = None
    _preconditioner: ConstraintPreconditioner

    def _load(self, program: Program) -> None:
        """Take other data; keep the last answer and working set."""
        limits = SpokeLimits.of(program)
        split = Split.of(program, self._backend.few_rows)
        self._problem = LimitedSum(program, limits, split)
        if limits.binding:
            return
        free = np.ones(split.few.columns.shape[1], dtype=bool)
        self._preconditioner = made = preconditioner(split, free)
        self._function = LeastSquares(split, made.complement)

    def _unlimited(self, accuracy: Accuracy) -> Candidate:
        """The field and the unknowns beside it, from the last answer."""
        function, tolerance = self._function, self._request.tolerance
        at = function.start() if self._at is None else self._at
        share = min(accuracy.rtol / (DUAL_MARGIN * tolerance), 1.0)
        found = self._minimum(at, self._goal(share, accuracy))
        self._at, p = found.at, function.field(found.at)
        x = np.concatenate([p, function.coefficients(p)])
        duals = duals_without_limits(self._program, x)
        claim = Claim.TIME_LIMIT if accuracy.late else Claim.DONE
        detail = self._preconditioner.description
        return Candidate(x, duals, found.steps, claim, detail)

    def _goal(self, share: float, accuracy: Accuracy) -> Goal:
        """The tolerance with its margins, times a share of the gap [–]."""
        function, tolerance = self._function, self._request.tolerance
        start = function.start()  # the given values, zero elsewhere
        slope = function.gradient(function.residual(np.zeros_like(start)))
        scale = float(np.linalg.norm(slope))
        least = (tolerance / STRICTER) ** 2 * function.value(start)
        gap, gradient = share * GAP, share * GRADIENT * tolerance * scale
        return Goal(gap * tolerance, gap * least, gradient, accuracy)

    def _minimum(self, at: Array, goal: Goal) -> Minimum:
        """Minimise until the verdict's bound of the gap is small as well.

        That bound starts from the Laplace term alone (docs/method, section 9.3) and
        exceeds the gap where other terms are stiffer. A few more steps are cheaper than
        refining the bound.
        """
        function, steps = self._function, 0
        enough = CLOSE_ENOUGH * self._request.tolerance
        for _ in range(BOUNDS):
            found = minimise(function, self._preconditioner, at, goal)
            steps, at = steps + found.steps, found.at
            if not found.reached:
                break
            value, bound = function.value(at), function.gap_bound(at)
            if bound <= 0.5 * enough * value:
                break
            goal = goal.times(0.1 * enough * value / bound)
        return replace(found, steps=steps)


class NormalEquations(Solver):
    """Preconditioned conjugate gradients on the normal equations.

    Attributes:
        few_rows: Most rows of a term that is eliminated through its dual [–].
    """

    name = "normal_equations"
    loaded = _Loaded
    summary = (
        "any sum of squares: multigrid for L and its kin under conjugate gradients"
    )
    capabilities = Capabilities(
        inequalities=True,
        equalities=True,
        keeps="the multigrid, the dual's directions, and the last answer to start from",
    )

    def __init__(self, few_rows: int = FEW_ROWS) -> None:
        self.few_rows = few_rows

    def refusal(self, program: Program) -> str:
        """Takes sums of squares with a Laplace term, and few unknowns beside p."""
        why = (
            super().refusal(program)
            or refusal_of_terms(program)
            or refusal_of_unknowns(program)
        )
        if why:
            return why
        V = len(program.laplace.free)
        if program.n_variables > V:
            for term in wide_terms(program, self.few_rows):
                if term.matrix[:, V:].nnz:
                    return (
                        f"{term.name} has many rows over other unknowns than the field"
                    )
            if any(np.isfinite(limit[V:]).any() for limit in program.box):
                return "it takes no bounds of unknowns beside the field"
        return refusal_of_limits(program)

    def cost(self, program: Program) -> float:
        """In proportion to the voxels."""
        s = Sizes.of(program)
        return 0.05 + 1e-5 * (6.0 if s.limits else 1.0) * s.voxels


SOLVERS = [NormalEquations()]
