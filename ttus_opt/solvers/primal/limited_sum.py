"""Limits with wide terms: working sets, each solved on the normal equations.

A working set gives p = Π ξ + o (`dual.subproblem`). The Laplace term becomes square
rows S and a few others, wide terms become M Π, and the preconditioner is that without
limits, with the multigrid of the pooled blocks.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.solvers.dual.active_set import LimitedProblem
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.solver import Accuracy, DualAnswer
from ttus_opt.solvers.dual.subproblem import Subproblem, reduced
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.dual.working_set import WorkingSet
from ttus_opt.solvers.primal.approximate_system import ApproximateSystem
from ttus_opt.solvers.primal.least_squares import (
    Goal,
    LeastSquares,
    minimise,
)
from ttus_opt.solvers.primal.matching import Root, matched_root
from ttus_opt.solvers.primal.preconditioner import ConstraintPreconditioner
from ttus_opt.solvers.primal.split import Split

#: Gap of a subproblem over its residual [–]
GAP = 1e-2


@dataclass(frozen=True)
class LimitedSum(LimitedProblem):
    """A program of the field alone, with limits and wide terms.

    Attributes:
        split: Its objective.
    """

    split: Split

    @cached_property
    def root(self) -> Root:
        """A root of its wide terms."""
        split = self.split
        return matched_root(split.wide, split.operator, split.few.system.compliance)

    def subproblem(self, active: WorkingSet) -> LimitedSubproblem:
        """The problem of a working set."""
        left = reduced(self.limits, active, self.split.few, self.root.added)
        split, system = _reduced_split(self.split, left), left.solver.system
        more = sp.csr_array(left.sums @ self.root.coupling @ left.expansion)
        # the columns of free voxels are part of A
        more = sp.csr_array(more @ sp.diags_array(_soft(system).astype(float)))
        more.eliminate_zeros()
        near = ApproximateSystem.of(system, more, split.wide)
        preconditioner = ConstraintPreconditioner(near)
        function = LeastSquares(split, preconditioner.complement)
        return LimitedSubproblem(function, preconditioner, left)


@dataclass(frozen=True)
class LimitedSubproblem:
    """The problem of a working set, without limits.

    Attributes:
        function: F of ξ.
        preconditioner: Its preconditioner.
        left: The subproblem as the dual has it.
    """

    function: LeastSquares
    preconditioner: ConstraintPreconditioner
    left: Subproblem = field(repr=False)

    def solve(self, accuracy: Accuracy, last: Array | None) -> DualAnswer:
        """The best field, after that of the last working set."""
        function = self.function
        at = function.start()
        scale = float(np.linalg.norm(function.gradient(function.residual(at))))
        value = function.value(at)
        if last is not None:
            p = np.where(function.split.moving, last, function.field(at))
            at = np.concatenate([p, function.misfit(p)])
        gap = GAP * accuracy.rtol
        goal = Goal(gap, gap**2 * value, accuracy.rtol * scale, accuracy)
        found = minimise(function, self.preconditioner, at, goal)
        p = self.left.expansion @ function.field(found.at) + self.left.offset
        y = found.at[len(function.split.few.b) :]
        return DualAnswer(p, np.zeros(0), found.steps, accuracy.late, y)


def _soft(system: DualSystem) -> Mask:
    """Soft values, shape (V,)."""
    return np.asarray(~system.laplace.free & (system.compliance > 0.0))


def _reduced_split(whole: Split, left: Subproblem) -> Split:
    """The terms over the unknowns ξ of a working set."""
    system, expansion = left.solver.system, left.expansion
    own, fixed = system.laplace.free, _soft(system)
    root = np.zeros(len(own))
    root[own | fixed] = 1.0 / np.sqrt(system.compliance[own | fixed])
    square = sp.csr_array(left.sums @ whole.operator.L @ expansion)
    one = sp.diags_array(np.where(fixed, root, 0.0))
    matrix = sp.csr_array(sp.diags_array(np.where(own, root, 0.0)) @ square + one)
    prior = replace(whole.prior, matrix=matrix, target=root * left.b, tags=frozenset())
    wide = tuple(
        replace(
            t,
            matrix=sp.csr_array(t.matrix @ expansion),
            target=t.target - t.matrix @ left.offset,
        )
        for t in whole.wide
    )
    few = DualData(system, left.b, left.t, np.zeros((len(left.t), 0)))
    return Split(prior, wide, few, own | fixed)
