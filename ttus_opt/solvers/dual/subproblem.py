"""A face of the feasible set: the problem that is left when some limits are active.

Where a bound is active its voxel is pinned; where a link along a spoke is active two
voxels are tied and move as one. With p = P z + o, z standing at one voxel of every
chain, what is left is a problem of the same structure, smaller and without limits:

- free voxels and free chains keep one Laplace row each, in the direction in which
  rows of a chain add up to PᵀA P; these rows make the square system;
- every other row, of pinned voxels, and across the chains, is a measured row like
  those of forces, of weight 1 and few entries.

So the dual of `system` solves it, with a multigrid that knows pins and ties.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.laplace.square_system import BlockSolves
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.multigrid import AggregatedMultigrid, Multigrid
from ttus_opt.solvers.dual.activity import Activity
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.voxmap.grid import CylindricalGrid


@dataclass(frozen=True)
class ReducedLaplace(BlockSolves):
    """Square system of a face, as `LaplaceSystem` is the whole problem's.

    Attributes:
        grid: The grid.
        free: Voxels at which unknowns stand, shape (V,).
        radii: What turns a row of A into one of L: the root of the sum of r² over a
            chain, shape (V,) [m].
        coupling: Entries from Dirichlet voxels to square rows, and their adjoint.
        members: All voxels that move with an unknown, shape (V,).
        ties: Among them, those tied to the next one outwards, shape (V,).
    """

    grid: CylindricalGrid
    free: Mask = field(repr=False)
    radii: Array = field(repr=False)
    coupling: tuple[sp.csr_array, sp.csr_array] = field(repr=False)
    members: Mask = field(repr=False)
    ties: Mask = field(repr=False)

    @cached_property
    def multigrid(self) -> Multigrid | AggregatedMultigrid:
        """Solver of the symmetric block."""
        if not self.ties.any():
            return Multigrid(self.grid, self.grid.unflatten(self.members))
        return AggregatedMultigrid(self.grid, self.members, self.ties, self.free)


@dataclass(frozen=True)
class Face:
    """The problem left on a face.

    Attributes:
        system: Its dual system.
        b: Right-hand side of its square system, shape (V,).
        t: Weighted targets of measured rows, then of left-over Laplace rows.
        spread: P, shape (V, V).
        offset: o, shape (V,).
    """

    system: DualSystem
    b: Array = field(repr=False)
    t: Array = field(repr=False)
    spread: sp.csr_array = field(repr=False)
    offset: Array = field(repr=False)

    @classmethod
    def whole(cls, data: DualData) -> Face:
        """The problem itself, no limit being active."""
        n = len(data.b)
        one = sp.csr_array(sp.eye_array(n, format="csr"))
        return cls(data.system, data.b, data.t, one, np.zeros(n))

    def field_of(self, z: Array) -> Array:
        """The field p = P z + o."""
        return np.asarray(self.spread @ z + self.offset)

    def unknowns_of(self, p: Array) -> Array:
        """The unknowns z of a field that need not lie on the face."""
        shown = np.zeros(len(p), dtype=bool)
        shown[self.spread.indices] = True
        return np.where(shown, p, 0.0)


@dataclass(frozen=True)
class _Chains:
    """Chains of tied voxels; single voxels are chains of one.

    Attributes:
        unknown: The voxel at which a voxel's chain stands; -1 if pinned, (V,).
        offset: o, shape (V,).
        dirichlet: Whether a voxel's chain holds a Dirichlet voxel, (V,).
    """

    unknown: IntArray
    offset: Array
    dirichlet: Mask

    @classmethod
    def of(
        cls, laplace: LaplaceSystem, limits: SpokeLimits, active: Activity
    ) -> _Chains:
        n, stride = len(active.pins), limits.stride
        head, depth = np.arange(n), np.zeros(n)
        least = np.where(active.ties, limits.least, 0.0)
        for start in range(stride, n, stride):
            own, inner = slice(start, start + stride), slice(start - stride, start)
            tied = active.ties[inner]
            head[own] = np.where(tied, head[inner], head[own])
            depth[own] = np.where(tied, depth[inner] - least[inner], 0.0)
        # where a chain stands: at its first Dirichlet voxel, else at its head
        stand = np.arange(n)
        fixed = np.flatnonzero(~laplace.free)[::-1]
        dirichlet = np.zeros(n, dtype=bool)
        dirichlet[head[fixed]] = True
        stand[head[fixed]] = fixed
        unknown = stand[head]
        offset = depth - depth[unknown]
        value = np.where(active.pins > 0, limits.upper, limits.lower)
        # a given value goes before a bound, and of several bounds the deepest
        pinned = np.flatnonzero((active.pins != 0) & ~limits.given)[::-1]
        pinned = np.concatenate([pinned, np.flatnonzero(limits.given)[::-1]])
        pin = np.full(n, -1)
        pin[head[pinned]] = pinned
        pin = pin[head]
        held = pin >= 0
        offset[held] = (depth + value[pin] - depth[pin])[held]
        unknown[held] = -1
        return cls(unknown, offset, dirichlet[head])


def face_of(
    laplace: LaplaceSystem,
    limits: SpokeLimits,
    active: Activity,
    data: DualData,
) -> Face:
    """The problem left when some limits are active.

    Args:
        laplace: L of the whole problem.
        limits: The limits.
        active: Which of them are active.
        data: The whole problem's dual.
    """
    system, b, t = data.system, data.b, data.t
    chains = _Chains.of(laplace, limits, active)
    n = len(b)
    voxels = np.arange(n)
    moving = chains.unknown >= 0
    spread = sp.csr_array(
        (
            np.ones(np.count_nonzero(moving)),
            chains.unknown[moving],
            np.concatenate([[0], np.cumsum(moving)]),
        ),
        shape=(n, n),
    )
    members = laplace.free & moving & ~chains.dirichlet
    shown = members & (chains.unknown == voxels)
    kept_fixed = moving & ~laplace.free & (chains.unknown == voxels)
    tied = members & (
        np.bincount(chains.unknown[members], minlength=n)[chains.unknown] > 1
    )
    target = b - laplace.L @ chains.offset

    # rows that are no longer a square row of their own
    across = _across_chains(laplace, chains, tied)
    loose = laplace.free & ~members
    loose |= moving & ~laplace.free & ~kept_fixed & (system.softness > 0.0)
    rest = sp.vstack([across, _unit_rows(np.flatnonzero(loose), n)], format="csr")
    extra = sp.csr_array(rest @ laplace.L @ spread)
    filled = np.diff(extra.indptr) > 0
    rows = sp.vstack([system.rows @ spread, extra[filled]], format="csr")
    measured = t - system.measure(chains.offset)

    gather, radii = _gather(laplace, chains, shown, tied)
    at_fixed = moving & kept_fixed[chains.unknown]
    inward = sp.csr_array(gather @ _of_columns(laplace.L, at_fixed) @ spread)
    inward.eliminate_zeros()
    reduced = ReducedLaplace(
        laplace.grid,
        shown,
        radii,
        (inward, sp.csr_array(inward.T)),
        members,
        tied & active.ties,
    )
    square = np.where(shown, gather @ target, np.where(kept_fixed, target, 0.0))
    return Face(
        DualSystem(
            reduced,
            np.where(shown, 1.0, np.where(kept_fixed, system.softness, 0.0)),
            sp.csr_array(rows),
            np.concatenate([system.root_weights, np.ones(np.count_nonzero(filled))]),
            len(system.root_weights),
        ),
        square,
        np.concatenate([measured, (rest @ target)[filled]]),
        spread,
        chains.offset,
    )


def _of_columns(matrix: sp.csr_array, kept: Mask) -> sp.csr_array:
    """The entries of some columns, the others zero; same shape."""
    own = kept[matrix.indices]
    indptr = np.concatenate([[0], np.cumsum(own)])[matrix.indptr]
    return sp.csr_array(
        (matrix.data[own], matrix.indices[own], indptr), shape=matrix.shape
    )


def _unit_rows(voxels: IntArray, n: int) -> sp.csr_array:
    """Rows that pick voxels, shape (k, n)."""
    return sp.csr_array(
        (np.ones(len(voxels)), voxels, np.arange(len(voxels) + 1)),
        shape=(len(voxels), n),
    )


def _gather(
    laplace: LaplaceSystem, chains: _Chains, shown: Mask, tied: Mask
) -> tuple[sp.csr_array, Array]:
    """The square rows from those of L, (V, V), and the radii that belong to them."""
    n = len(shown)
    squares = np.bincount(chains.unknown[tied], laplace.radii[tied] ** 2, minlength=n)
    radii = np.where(squares > 0.0, np.sqrt(squares), laplace.radii)
    own = np.flatnonzero(shown | tied)
    to = np.where(tied, chains.unknown, np.arange(n))[own]
    share = np.where(tied[own], laplace.radii[own] / radii[to], 1.0)
    return sp.csr_array((share, (to, own)), shape=(n, n)), radii


def _across_chains(laplace: LaplaceSystem, chains: _Chains, tied: Mask) -> sp.csr_array:
    """Orthonormal rows across every chain of k voxels: k - 1 each, shape (m, V)."""
    n = len(tied)
    voxels = np.flatnonzero(tied)
    # by chain, and within a chain from the inside out (flat order)
    voxels = voxels[np.argsort(chains.unknown[voxels], kind="stable")]
    ends = np.flatnonzero(np.diff(chains.unknown[voxels], append=-1, prepend=-1))
    blocks, columns = [], []
    for start, end in pairwise(ends):
        own = voxels[start:end]
        w = laplace.radii[own] / np.linalg.norm(laplace.radii[own])
        # Householder's reflection takes w to the first axis: its other rows are
        # orthogonal to w and to each other
        v = w.copy()
        v[0] += 1.0
        mirror = np.eye(len(own)) - np.outer(v, v) / v[0]
        blocks.append(mirror[1:])
        columns.append(own)
    if not blocks:
        return sp.csr_array((0, n))
    lengths = np.concatenate([np.full(len(c) - 1, len(c)) for c in columns])
    indices = np.concatenate([np.tile(c, len(c) - 1) for c in columns])
    return sp.csr_array(
        (
            np.concatenate([block.reshape(-1) for block in blocks]),
            indices,
            np.concatenate([[0], np.cumsum(lengths)]),
        ),
        shape=(len(lengths), n),
    )
