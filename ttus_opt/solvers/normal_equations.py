"""Normal equations: any sum of squares beside a Laplace term, never factorised.

Conjugate gradients on H p = d, H = LᵀΩ⁻¹L + Σ w MᵀM + DᵀD
(docs/method/solver-variants.md, section 10.10). The preconditioner is (L - X)ᵀ(L - X)
by multigrid, with X a root of the wide terms (`primal.matching`), and takes the few
rows D through their dual (`primal.preconditioner`). A new solve keeps the multigrid,
the dual's directions and the last solution to start from.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.absorption import CLOSE_ENOUGH
from ttus_opt.problem.verify.kkt import STRICTER, Duals, kkt_residuals
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Prepared,
    Request,
    Solver,
)
from ttus_opt.solvers.dual.data import duals_without_limits
from ttus_opt.solvers.dual.limited import Limited, candidate_of
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.options import Accuracy, DualOptions
from ttus_opt.solvers.dual.refusals import (
    refusal_of_limits,
    refusal_of_terms,
    refusal_of_unknowns,
)
from ttus_opt.solvers.primal.least_squares import LeastSquares, preconditioner
from ttus_opt.solvers.primal.limited_sum import LimitedSum
from ttus_opt.solvers.primal.minimise import Goal, Minimum, minimise
from ttus_opt.solvers.primal.options import PrimalOptions
from ttus_opt.solvers.primal.preconditioner import ConstraintPreconditioner
from ttus_opt.solvers.primal.split import Split, wide_terms
from ttus_opt.solvers.sizes import Sizes

#: Most continuations of a solve until the bound of its gap is small enough
BOUNDS = 4

#: Most unknowns beside the field
MOST = 64


class NormalEquations(Solver):
    """Preconditioned conjugate gradients on the normal equations.

    Attributes:
        options: Options of the method.
    """

    name = "normal_equations"
    summary = (
        "any sum of squares: multigrid for L and its kin under conjugate gradients"
    )
    capabilities = Capabilities(
        inequalities=True,
        equalities=True,
        keeps="the multigrid, the dual's directions, and the last answer to start from",
    )

    def __init__(self, options: PrimalOptions | None = None) -> None:
        self.options = options or PrimalOptions()

    def refusal(self, program: Program) -> str:
        """Takes sums of squares with a Laplace term, and few unknowns beside p."""
        why = (
            super().refusal(program)
            or refusal_of_terms(program)
            or refusal_of_unknowns(program, MOST)
        )
        if why:
            return why
        V = len(program.laplace.free)
        if program.n_variables > V:
            for term in wide_terms(program, self.options.few_rows):
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

    def prepare(self, program: Program, request: Request) -> Prepared:
        """Set up the multigrid."""
        self.require(program)
        if SpokeLimits.of(program).binding:
            return _LoadedLimits(program, request, self.options)
        return _Loaded(program, request, self.options)


class _Loaded(Prepared):
    _last: Array | None = None
    _preconditioner: ConstraintPreconditioner

    def __init__(
        self, program: Program, request: Request, options: PrimalOptions
    ) -> None:
        self._request, self._options = request, options
        self.update(program)

    def update(self, program: Program) -> None:
        """Take other data."""
        self._program = program
        split = Split.of(program, self._options.few_rows)
        free = np.ones(split.few.columns.shape[1], dtype=bool)
        self._preconditioner = preconditioner(split, free, self._options, DualOptions())
        self._function = LeastSquares(split, self._preconditioner.complement)

    def solve(self) -> Candidate:
        """Minimise, check, and repeat with a smaller gap where needed."""
        limit = self._request.time_limit
        deadline = None if limit is None else time.perf_counter() + limit
        accuracy = Accuracy(0.0, deadline=deadline)
        function, tolerance = self._function, self._request.tolerance
        at = function.start() if self._last is None else self._last
        scale = _Scale.of(function)
        share, steps, least = 1.0, 0, np.inf
        best = Candidate(None, claim=Claim.TIME_LIMIT, detail="no time")
        for _ in range(self._options.tightenings):
            goal = self._goal(share, scale, accuracy)
            found = self._minimum(at, goal)
            steps += found.steps
            p = function.field(found.at)
            x = np.concatenate([p, function.coefficients(p)])
            duals = duals_without_limits(self._program, x)
            kkt = kkt_residuals(self._program, x, duals, tolerance=tolerance)
            gained = kkt.worst_relative < least
            if gained or best.x is None:
                claim = Claim.TIME_LIMIT if accuracy.late else Claim.DONE
                best, least = Candidate(x, duals, steps, claim), kkt.worst_relative
                at = self._last = found.at
            if least <= tolerance or not gained or accuracy.late:
                break
            share *= self._options.tightening
        return replace(best, iterations=steps, detail=self._preconditioner.description)

    def _goal(self, share: float, scale: _Scale, accuracy: Accuracy) -> Goal:
        """The tolerance with its margins, times a share of the gap [–]."""
        options, tolerance = self._options, self._request.tolerance
        gap = share * options.gap_margin
        return Goal(
            gap * tolerance,
            gap * (tolerance / STRICTER) ** 2 * scale.value,
            share * options.dual_margin * tolerance * scale.gradient,
            options.max_steps,
            accuracy,
        )

    def _minimum(self, at: Array, goal: Goal) -> Minimum:
        """Minimise until the verdict's bound of the gap is small as well.

        That bound starts from the Laplace term alone (docs/method, section 9.3) and
        exceeds the gap where other terms are stiffer. A few more steps are cheaper than
        refining the bound.
        """
        options, function, steps = self._options, self._function, 0
        rounds = options.rounds, options.round_gain
        enough = CLOSE_ENOUGH * self._request.tolerance
        for _ in range(BOUNDS):
            found = minimise(function, self._preconditioner, at, goal, *rounds)
            steps, at = steps + found.steps, found.at
            if not found.reached:
                break
            value, bound = function.value(at), function.gap_bound(at)
            if bound <= 0.5 * enough * value:
                break
            goal = goal.times(0.1 * enough * value / bound)
        return replace(found, steps=steps)


class _LoadedLimits(Limited):
    def __init__(
        self, program: Program, request: Request, options: PrimalOptions
    ) -> None:
        self._primal = options
        super().__init__(program, request, DualOptions())

    def update(self, program: Program) -> None:
        """Take other data; keep the last working set."""
        self._program, self._limits = program, SpokeLimits.of(program)
        split = Split.of(program, self._primal.few_rows)
        self._problem = LimitedSum(
            program, self._limits, split, split.root(), self._primal, self._options
        )

    def solve(self) -> Candidate:
        """Solve working sets."""
        return self._contradiction(self._limits) or self._tightened(self._limited)

    def _proof(self, limits: SpokeLimits) -> Duals:
        return limits.proof_of_contradiction() or Duals()

    def _limited(self, accuracy: Accuracy) -> Candidate:
        """The field within its limits."""
        found = self._within(self._problem, self._limits, accuracy)
        return candidate_of(found, found.p, found.multipliers.duals(self._limits))


@dataclass(frozen=True)
class _Scale:
    """Scales of relative residuals.

    Attributes:
        value: F at the given values, zero elsewhere.
        gradient: Norm of half the gradient at zero.
    """

    value: float
    gradient: float

    @classmethod
    def of(cls, function: LeastSquares) -> _Scale:
        start = function.start()
        slope = function.gradient(function.residual(np.zeros_like(start)))
        return cls(function.value(start), float(np.linalg.norm(slope)))


SOLVERS = [NormalEquations()]
