"""Penalties other than squares, without smoothing: the method of multipliers.

Absolute values, Huber's, groups and total variation on any sparse rows, with squares
and limits. Where all rows but a few are Laplace's, Newton steps are solved in the dual,
as in `structured`; otherwise by conjugate gradients over the field.

See docs/method/solver-variants.md, Penalties other than squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.members import StackedTerms
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import Reduction
from ttus_opt.problem.terms.penalties import Absolute, Penalty, Squares
from ttus_opt.problem.terms.structure import LaplaceRows
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Candidate, Capabilities, Prepared, Solver
from ttus_opt.solvers.proximal.field_newton import FieldNewton
from ttus_opt.solvers.proximal.laplace_newton import LaplaceNewton
from ttus_opt.solvers.proximal.method_of_multipliers import (
    MethodOfMultipliers,
    NewtonSystem,
    State,
)
from ttus_opt.solvers.proximal.penalised_rows import Anchor, Between, PenalisedRows
from ttus_opt.solvers.proximal.problem import PenalisedProblem
from ttus_opt.solvers.proximal.source_exchange import EXCESS, SourceExchange
from ttus_opt.solvers.sizes import Sizes

#: Weight of the anchor over the largest σ; where all penalties are squares [–]
ANCHOR, WEAK = 10.0, 1e-3

#: Largest first multiplier over the weight, which sets σ [–]
START = 1.5


class _Loaded(Prepared):
    """A program with its last solution."""

    _last: Array | None = None

    def update(self, program: Program) -> None:
        """Take other data; the next solve starts from the last solution."""
        self._reduced = program
        declared = program.declared or program
        self._problem = PenalisedProblem.of(declared)
        if declared.laplace is not None:
            declared.laplace.multigrid  # noqa: B018  (counts as set-up)

    def solve(self) -> Candidate:
        """Solve the declared program; the candidate is one of the reduced program."""
        problem = self._problem
        if _is_sparse_sources(problem):
            exact = self._exchanged()
            if exact is not None:
                return exact
        whole = _anchored(problem)
        few = problem.few_beside_laplace
        system: NewtonSystem = LaplaceNewton(whole) if few else FieldNewton(whole)
        method = MethodOfMultipliers(whole, system, self._request)
        found = method.solve(self._start(whole, system))
        assert found.x is not None
        self._last = found.x
        point = Reduction(problem.program, self._reduced).lift(found.x, found.duals)
        return replace(
            found,
            x=point.x,
            duals=point.duals,
            iterations=method.newton_steps,
            detail=f"{method.newton_steps} Newton steps, {method.steps} inner steps",
        )

    def _exchanged(self) -> Candidate | None:
        """Sparse sources by column exchange; None where that misses the tolerance."""
        problem, request = self._problem, self._request
        deadline = request.deadline()
        program, laplace = problem.program, problem.program.laplace
        own = next(b for b in problem.blocks if b.laplace is not None)
        rows = own.laplace
        assert rows is not None
        few = [t for t in program.terms if t.weight and t.name != own.name]
        free = np.flatnonzero(laplace.free)
        scale = np.ones(len(free)) if rows.scale is None else rows.scale[free]
        side = problem.values.copy()
        side[free] = own.target / scale
        charge = np.full(len(side), np.inf)
        charge[free] = own.weight * scale
        stacked = StackedTerms.of(few, len(side), over=0.5)
        D, t = stacked.weighted, stacked.root * stacked.target
        exchange = SourceExchange(laplace, D, t, charge, laplace.solve(side))
        for tight in (False, True):
            if tight:
                exchange.tighten(deadline)
            found = exchange.run(EXCESS, deadline)
            x = np.where(problem.fixed, problem.values, found)
            y = {own.name: exchange.multipliers(found)[free] / scale}
            multipliers = [
                y.get(b.name, np.zeros(len(b.target))) for b in problem.blocks
            ]
            gradient = D.T @ (D @ x - t) + own.adjoint(y[own.name])
            duals = problem.duals(multipliers, gradient)
            kkt = kkt_residuals(program, x, duals, tolerance=request.tolerance)
            request.tell(kkt.worst_relative)
            if kkt.worst_relative <= request.tolerance:
                break
        else:
            return None
        self._last = x
        point = Reduction(program, self._reduced).lift(x, duals)
        detail = f"{exchange.solves} solves, {exchange.sources} sources"
        return Candidate(point.x, point.duals, exchange.solves, detail=detail)

    def _start(self, whole: PenalisedProblem, system: NewtonSystem) -> Array:
        """A starting point; sets every σ by one Newton step without kinks."""
        problem, anchor = self._problem, whole.anchor
        x = self._first_point()
        if anchor is not None:
            anchor.follow(x, anchor.multipliers, 1.0)
        size = float(np.abs(x).max()) or 1.0
        bent = [b for b in problem.bent if not isinstance(b.law, Between)]
        limits = [b for b in problem.bent if isinstance(b.law, Between)]
        for b in bent:
            b.multipliers[:] = 0.0
            b.sigma = b.weight / (size * _longest(b.matrix))
        stiffness = _stiffness(problem.blocks)
        for b in limits:
            b.multipliers[:] = 0.0
            b.sigma = stiffness
        if not bent:  # squares alone: a weak anchor for undetermined variables
            _weigh(anchor, limits, WEAK)
            return x
        _weigh(anchor, bent)
        state = State.of(x, whole.blocks)
        free = np.where(problem.fixed, 0.0, state.gradient)
        d, _ = system.step(free, state.multipliers, state.slopes, 1e-2, None)
        for b in bent:
            largest = float(np.abs(b.residual(x + d)).max(initial=0.0))
            if largest > 0.0:
                b.sigma = START * b.weight / largest
        _weigh(anchor, bent)
        return x

    def _first_point(self) -> Array:
        """The last solution, or the Laplace field, with the given values."""
        program, fixed, values = (
            self._problem.program,
            self._problem.fixed,
            self._problem.values,
        )
        x = np.zeros(len(fixed)) if self._last is None else self._last
        if self._last is None and program.laplace is not None:
            p, prior = program.variables["p"], program.laplace_term_of("p")
            b = values[p]
            if prior is not None and prior.matrix.shape[0] == len(b):
                b = np.where(fixed[p], b, prior.target)
            x[p] = program.laplace.solve(b, rtol=1e-10)
        return np.where(fixed, values, x)


class AugmentedLagrangian(Solver):
    """Proximal method of multipliers with semismooth Newton steps."""

    name = "augmented_lagrangian"
    loaded = _Loaded
    summary = "semismooth Newton in the method of multipliers: no penalty is rewritten"
    capabilities = Capabilities(
        inequalities=True,
        equalities=True,
        nonquadratic=True,
        keeps="the multigrid, the last answer to start from",
    )

    def refusal(self, program: Program) -> str:
        """Takes penalties with a resolvent, and no cones.

        Squares alone only with limits and without a Laplace term.
        """
        declared = program.declared or program
        if declared.cones:
            return "it takes no cones"
        mute = [
            t.name
            for t in declared.terms
            if type(t.penalty).resolvent is Penalty.resolvent
        ]
        if mute:
            return f"the penalty of {mute[0]} does not implement resolvent()"
        if declared.is_quadratic and not _is_limited_alone(declared):
            return "all penalties are squares: other solvers take them faster"
        return ""

    def cost(self, program: Program) -> float:
        """In proportion to the voxels, where L has a multigrid."""
        if program.laplace is None:
            return math.inf
        s = Sizes.of(program)
        limited = s.limits > s.kinks  # a kink's own bounds are not the program's
        return 0.6 + 1e-4 * (2.0 if limited else 1.0) * s.voxels


def _is_limited_alone(program: Program) -> bool:
    """Whether there are limits, and no Laplace term whose solvers take them."""
    prior = program.laplace_prior
    if (prior is not None and prior.weight > 0.0) or not program.terms:
        return False
    beyond = [c for c in program.constraints if (c.lower != c.upper).any()]
    return bool(beyond or program.bounds)


def _anchored(problem: PenalisedProblem) -> PenalisedProblem:
    """The problem, with a proximal term where squares do not determine x."""
    program = problem.program
    if problem.held_by_laplace and len(program.variables) == 1:
        return problem
    if problem.few_beside_laplace:
        laplace, scale = program.laplace, np.ones(len(problem.fixed))
        rows = laplace.L[np.flatnonzero(laplace.free)]
        return problem.anchored(rows, LaplaceRows(scale=scale))
    eye = sp.eye_array(program.n_variables, format="csr")
    return problem.anchored(sp.csr_array(eye))


def _weigh(
    anchor: Anchor | None, rows: Sequence[PenalisedRows], share: float = ANCHOR
) -> None:
    """Give an anchor its weight beside the σ of some rows."""
    if anchor is not None and rows:
        anchor.weigh(0.5 * share * max(b.sigma for b in rows))


def _stiffness(blocks: Sequence[PenalisedRows]) -> float:
    """Mean curvature of the blocks that are not limits, over the variables."""
    total = 0.0
    for b in blocks:
        if not isinstance(b.law, Between):
            curvature = 2.0 * b.weight if b.exact else b.sigma
            total += curvature * float((b.matrix.data**2).sum()) / b.matrix.shape[1]
    return total


def _longest(matrix: sp.csr_array) -> float:
    squares = np.asarray(matrix.multiply(matrix).sum(axis=1)).reshape(-1)
    return float(np.sqrt(squares.max(initial=0.0))) or 1.0


def _is_sparse_sources(problem: PenalisedProblem) -> bool:
    """Whether it is absolute values of Laplace's rows beside few squares."""
    if not problem.few_beside_laplace or problem.fixed.sum() == 0:
        return False
    own = [b for b in problem.blocks if b.laplace is not None]
    few = [b for b in problem.blocks if b.laplace is None]
    free = int(problem.program.laplace.free.sum())
    return (
        len(own) == 1
        and isinstance(own[0].law, Absolute)
        and len(own[0].target) == free
        and all(isinstance(b.law, Squares) for b in few)
    )


SOLVERS = [AugmentedLagrangian()]
