"""The subproblem of a working set of one field.

An active bound holds its voxel; an active order constraint pools two voxels into a
block with a common unknown. With p = P z + o, where z has one entry per block, the
remaining problem has the same structure, is smaller and has no limits:

- every free voxel or block keeps one Laplace row, for a block the combination of its
  rows that gives PᵀA P; these rows form the square system;
- every other row, of held voxels or orthogonal to the kept one of a block, becomes a
  measured row of weight 1 with few entries.

The dual of `system` solves it, with a multigrid for the held and pooled voxels.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.laplace.multigrid import Added, Multigrid, OneCycle, PooledBlocks
from ttus_opt.laplace.multigrid.pooled_blocks import block_heads
from ttus_opt.laplace.system import BlockSystem, LaplaceSystem
from ttus_opt.solvers.dual.active_set import LimitedProblem
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.limits import Multipliers, SpokeLimits
from ttus_opt.solvers.dual.soft_values import SoftValues
from ttus_opt.solvers.dual.solver import Accuracy, DualAnswer, DualSolver
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.dual.working_set import WorkingSet

#: Soft values are predicted only if other voxels' worst violation is at most this part
#: of theirs [–]: it is 0.2 at weights of 10, and 0.3 and more for contradictory data
MENDED = 0.25


@dataclass(frozen=True)
class Subproblem:
    """The problem of a working set.

    Attributes:
        solver: Solver of its dual.
        b: Right-hand side of its square system, shape (V,).
        t: Weighted targets of measured rows, then of the other Laplace rows.
        expansion: P, shape (V, V).
        offset: o, shape (V,).
        sums: Map from the rows of L to the square rows, shape (V, V).
    """

    solver: DualSolver
    b: Array = field(repr=False)
    t: Array = field(repr=False)
    expansion: sp.csr_array = field(repr=False)
    offset: Array = field(repr=False)
    sums: sp.csr_array = field(repr=False)

    def solve(self, accuracy: Accuracy, last: Array | None = None) -> DualAnswer:
        """The minimiser of the working set."""
        answer = self.solver.solve(self.b, self.t, accuracy)
        return replace(answer, p=self.expansion @ answer.p + self.offset)


@dataclass(frozen=True)
class LimitedField(LimitedProblem):
    """One whose working sets are solved through the dual.

    Attributes:
        data: The dual of the problem without limits.
        whole: Solver of that dual, reused from solve to solve.
    """

    data: DualData
    whole: DualSolver

    @cached_property
    def _limited_soft(self) -> Mask:
        """Soft values with only a lower limit, shape (V,)."""
        limits, soft = self.limits, self.data.system.compliance > 0.0
        own = np.isfinite(limits.lower) & np.isinf(limits.upper) & ~limits.given
        return ~self.program.laplace.free & soft & own

    @cached_property
    def _soft_values(self) -> SoftValues:
        return SoftValues(self.data.system)

    def predicted(
        self, active: WorkingSet, p: Array, signs: Multipliers
    ) -> WorkingSet | None:
        """The predicted working set if only soft values are at limits, or None."""
        limits, soft, system = self.limits, self._limited_soft, self.data.system
        prior = self.program.laplace_prior
        assert prior is not None
        others = ~soft & ~limits.given
        beyond = np.maximum(limits.lower - p, p - limits.upper)
        # before any limit is active, soft values will correct some violations
        share = MENDED if active.count == 0 else 0.0
        most = share * float(beyond[soft].max(initial=0.0))
        far = float(beyond[others].max(initial=0.0)) > most
        if not soft.any() or far or (others & (active.bounds != 0)).any():
            return None
        # b + ω q; at a held voxel its multiplier adds to p
        natural = p + system.compliance * signs.bounds / (2.0 * prior.weight)
        held = soft & (natural < limits.lower)
        model = self._soft_values
        at = model.voxels
        lower = np.where(soft, limits.lower, -np.inf)[at]
        near = model.held(p[at], natural[at], lower)
        if near is None:
            return None
        held[at] = near
        following = WorkingSet(
            np.where(limits.given, active.bounds, -held.astype(np.int8)), active.links
        )
        return following if following.differs(active) else None

    def subproblem(self, active: WorkingSet) -> Subproblem:
        """The problem of a working set."""
        data = self.data
        if active.count == 0:
            n = len(data.b)
            one = sp.csr_array(sp.eye_array(n, format="csr"))
            return Subproblem(self.whole, data.b, data.t, one, np.zeros(n), one)
        return reduced(self.limits, active, data)


@dataclass(frozen=True)
class Blocks:
    """Pooled voxels; single voxels are blocks of one.

    Attributes:
        unknown: The voxel that represents a voxel's block; -1 if held, (V,).
        offset: o, shape (V,).
        dirichlet: Whether a voxel's block contains a Dirichlet voxel, (V,).
    """

    unknown: IntArray
    offset: Array
    dirichlet: Mask

    @cached_property
    def own(self) -> Mask:
        """Voxels that represent their block, shape (V,)."""
        return np.asarray(self.unknown == np.arange(len(self.unknown)))

    @cached_property
    def expansion(self) -> sp.csr_array:
        """P, shape (V, V)."""
        return _selection(self.unknown >= 0, self.unknown)

    @classmethod
    def of(cls, free: Mask, limits: SpokeLimits, active: WorkingSet) -> Blocks:
        """The blocks of a working set.

        Args:
            free: Voxels that are not Dirichlet, shape (V,).
            limits: The limits.
            active: Which of them are active.
        """
        n = len(active.bounds)
        head = block_heads(active.links, limits.stride)
        # a block is represented by its first Dirichlet voxel, else by its head
        stand = np.arange(n)
        fixed = np.flatnonzero(~free)[::-1]
        dirichlet = np.zeros(n, dtype=bool)
        dirichlet[head[fixed]] = True
        stand[head[fixed]] = fixed
        unknown = stand[head]
        # decrease of the field along a block, from the spoke's inner end
        falls = limits.by_layer(np.where(active.links, limits.least, 0.0))
        depth = np.zeros_like(falls)
        depth[1:] = -np.cumsum(falls[:-1], axis=0)
        depth = depth.reshape(-1)
        offset = depth - depth[unknown]
        value = np.where(active.bounds > 0, limits.upper, limits.lower)
        # a given value precedes a bound, and the deepest of several bounds the others
        held = np.flatnonzero((active.bounds != 0) & ~limits.given)[::-1]
        held = np.concatenate([held, np.flatnonzero(limits.given)[::-1]])
        at = np.full(n, -1)
        at[head[held]] = held
        at = at[head]
        offset = np.where(at >= 0, value[at] + (depth - depth[at]), offset)
        return cls(np.where(at >= 0, -1, unknown), offset, dirichlet[head])


def reduced(
    limits: SpokeLimits,
    active: WorkingSet,
    data: DualData,
    cycle: Added | None = None,
) -> Subproblem:
    """The subproblem in general.

    Args:
        limits: The limits.
        active: Which of them are active.
        data: The dual of the whole problem.
        cycle: What is added to A, for one V-cycle in place of A⁻¹; None for solves.
    """
    system, laplace, n = data.system, data.system.laplace, len(data.b)
    assert isinstance(laplace, LaplaceSystem)
    blocks = Blocks.of(laplace.free, limits, active)
    moving, expansion = blocks.unknown >= 0, blocks.expansion
    members = laplace.free & moving & ~blocks.dirichlet
    own = members & blocks.own
    fixed = moving & ~laplace.free & blocks.own
    sizes = np.bincount(blocks.unknown[members], minlength=n)
    pooled = members & (sizes[blocks.unknown] > 1)
    target = data.b - laplace.L @ blocks.offset

    # rows that are no longer square rows
    across = _across_blocks(laplace, blocks, pooled)
    loose = laplace.free & ~members
    loose |= moving & ~laplace.free & ~fixed & (system.compliance > 0.0)
    rest = sp.csr_array(sp.vstack([across, _selection(loose, np.arange(n))[loose]]))
    extra = sp.csr_array(rest @ laplace.L @ expansion)
    filled = np.diff(extra.indptr) > 0
    rows = sp.vstack([system.rows @ expansion, extra[filled]], format="csr")
    measured = data.t - system.measure(blocks.offset)

    sums, radii = _sums(laplace, blocks, own, pooled)
    at_fixed = moving & fixed[blocks.unknown]
    to_fixed = sp.csr_array(laplace.L @ sp.diags_array(at_fixed.astype(float)))
    to_fixed.eliminate_zeros()
    inward = sp.csr_array(sums @ to_fixed @ expansion)
    inward.eliminate_zeros()
    coupling = inward, sp.csr_array(inward.T)
    grid, links = laplace.operator_grid, pooled & active.links
    stride = limits.stride
    together = PooledBlocks.of(members, links, own, stride) if links.any() else None
    free, kind = grid.unflatten(members), OneCycle if cycle else Multigrid
    block = kind(grid, free, blocks=together, added=cycle or laplace.added)
    left = DualSystem(
        BlockSystem(own, radii, coupling, block),
        np.where(own, 1.0, np.where(fixed, system.compliance, 0.0)),
        sp.csr_array(rows),
        np.concatenate([system.root_weights, np.ones(np.count_nonzero(filled))]),
        len(system.root_weights),
    )
    return Subproblem(
        DualSolver(left),
        np.where(own, sums @ target, np.where(fixed, target, 0.0)),
        np.concatenate([measured, (rest @ target)[filled]]),
        expansion,
        blocks.offset,
        sums,
    )


def _selection(rows: Mask, columns: IntArray) -> sp.csr_array:
    """Ones at (v, columns[v]) for some rows v, shape (V, V)."""
    indptr = np.concatenate([[0], np.cumsum(rows)])
    entries = np.ones(indptr[-1]), columns[rows], indptr
    return sp.csr_array(entries, shape=(len(rows), len(rows)))


def _sums(
    laplace: LaplaceSystem, blocks: Blocks, own: Mask, pooled: Mask
) -> tuple[sp.csr_array, Array]:
    """Map from the rows of L to the square rows, (V, V), and the radii of these."""
    n = len(own)
    squares = np.bincount(
        blocks.unknown[pooled], laplace.radii[pooled] ** 2, minlength=n
    )
    radii = np.where(squares > 0.0, np.sqrt(squares), laplace.radii)
    at = np.flatnonzero(own | pooled)
    to = np.where(pooled, blocks.unknown, np.arange(n))[at]
    share = np.where(pooled[at], laplace.radii[at] / radii[to], 1.0)
    return sp.csr_array((share, (to, at)), shape=(n, n)), radii


def _across_blocks(
    laplace: LaplaceSystem, blocks: Blocks, pooled: Mask
) -> sp.csr_array:
    """Orthonormal rows orthogonal to the kept one, k - 1 per block, shape (m, V)."""
    voxels = np.flatnonzero(pooled)
    # by block, and within a block from the inside out (flat order)
    voxels = voxels[np.argsort(blocks.unknown[voxels], kind="stable")]
    ends = np.flatnonzero(np.diff(blocks.unknown[voxels], append=-1, prepend=-1))
    entries, columns, lengths = [np.zeros(0)], [np.zeros(0, dtype=np.int64)], [0]
    for start, end in pairwise(ends):
        own = voxels[start:end]
        w = laplace.radii[own] / np.linalg.norm(laplace.radii[own])
        # the Householder reflection that maps w to the first axis: its other rows are
        # orthogonal to w and to each other
        v = w.copy()
        v[0] += 1.0
        mirror = np.eye(len(own)) - np.outer(v, v) / v[0]
        entries.append(mirror[1:].reshape(-1))
        columns.append(np.tile(own, len(own) - 1))
        lengths += [len(own)] * (len(own) - 1)
    return sp.csr_array(
        (np.concatenate(entries), np.concatenate(columns), np.cumsum(lengths)),
        shape=(len(lengths) - 1, len(pooled)),
    )
