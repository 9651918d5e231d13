"""Any sum of squares without a Laplace term: a factor or a multigrid.

The method of multipliers without multipliers: one Newton step of
`proximal.field_newton`, repeated for rounding's sake. Its preconditioner inverts the
matrix of all short rows approximately and takes the few long rows, those of
measurements, by their Schur complement. With a Laplace term,
`normal_equations` is faster.

See docs/method/solver-variants.md, section 10.10.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import MissingPackageError
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import (
    LEAST_TOLERANCE,
    Candidate,
    Capabilities,
    Claim,
    Prepared,
    Solver,
)
from ttus_opt.solvers.proximal.field_newton import FieldNewton
from ttus_opt.solvers.proximal.method_of_multipliers import MethodOfMultipliers, State
from ttus_opt.solvers.proximal.problem import PenalisedProblem
from ttus_opt.solvers.sizes import Sizes

#: Relative KKT residual aimed for, over the tolerance, which is that of the program
#: before its measured rows were compressed [–]
MARGIN = 0.1

#: Most voxels with a prior whose covariance is known, the inverse of a matrix that is
#: conditioned like Δ² in three directions: 52 s for 51,840, no answer after 540 s for
#: 345,600
MOST_KNOWN = 100_000


class _Loaded(Prepared):
    _last: Array | None = None
    _made: tuple[tuple[ProgramTerm, ...], FieldNewton] | None = None

    def update(self, program: Program) -> None:
        """Take other data; keep the preconditioner while the matrices stay the same."""
        self._problem = problem = PenalisedProblem.of(program)
        self._missing = ""
        at = problem.values if self._last is None else self._last
        self._last = np.where(problem.fixed, problem.values, at)
        terms = tuple(t for t in program.terms if t.weight > 0.0)
        if self._made is None or not _same(self._made[0], terms):
            self._made = None
            system = FieldNewton(problem, squares=True)
            try:
                system.preconditioner(State.of(self._last, problem.blocks).slopes)
                self._made = terms, system
            except MissingPackageError as error:
                self._missing = str(error)

    def solve(self) -> Candidate:
        """Newton steps from the last answer; one is enough, but for rounding."""
        if self._made is None or self._last is None:
            return Candidate(None, claim=Claim.GAVE_UP, detail=self._missing)
        tolerance = max(MARGIN * self._request.tolerance, LEAST_TOLERANCE)
        request = replace(self._request, tolerance=tolerance)
        method = MethodOfMultipliers(self._problem, self._made[1], request)
        found = method.solve(self._last)
        self._last = found.x
        claim = Claim.DONE if found.claim is Claim.GAVE_UP else found.claim
        detail = f"{self._made[1].description}, {method.steps} steps"
        return replace(found, iterations=method.steps, claim=claim, detail=detail)


class Algebraic(Solver):
    """Conjugate gradients over a factor, the grid's multigrid or pyamg."""

    name = "algebraic"
    loaded = _Loaded
    summary = (
        "any sum of squares without a Laplace term: a factor or a multigrid under "
        "conjugate gradients"
    )
    capabilities = Capabilities(
        inequalities=False,
        equalities=True,
        keeps="the factor or multigrid while weights stay, the last answer",
    )

    def refusal(self, program: Program) -> str:
        """Takes sums of squares without a Laplace term, and given values."""
        if base := super().refusal(program):
            return base
        others = [t.name for t in program.terms if not t.is_squares]
        if others:
            return f"{others[0]} is not a sum of squares"
        known, voxels = program.known_prior, Sizes.of(program).voxels
        if known is not None and voxels > MOST_KNOWN:
            return (
                f"it takes {MOST_KNOWN:,} voxels at most with {known.name}, whose "
                f"covariance is known, and these are {voxels:,}: use covariance"
            )
        prior = program.laplace_prior
        if prior is not None and prior.weight > 0.0:
            return f"it takes no Laplace term ({prior.name}): use normal_equations"
        for constraint in program.constraints:
            if (np.diff(constraint.matrix.indptr) != 1).any():
                return f"it takes given values, and {constraint.name} is more than that"
        return ""

    def cost(self, program: Program) -> float:
        """In proportion to the voxels; more where a covariance is known."""
        s = Sizes.of(program)
        return 0.1 + (4e-5 if program.known_prior is None else 1e-3) * s.voxels


def _same(one: tuple[ProgramTerm, ...], other: tuple[ProgramTerm, ...]) -> bool:
    """Whether matrices and weights are the same."""
    return len(one) == len(other) and all(
        a.matrix is b.matrix and a.weight == b.weight
        for a, b in zip(one, other, strict=True)
    )


SOLVERS = [Algebraic()]
