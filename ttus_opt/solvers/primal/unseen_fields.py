"""Deflation of the null space of heavy difference terms.

Rows whose entries sum to zero do not see a field that is constant on every connected
set of their voxels, such as lines along z for differences along z. The root X
(`solvers.primal.matching`) approximates such rows well for waves, but is far too stiff
for constants. These fields E are therefore solved for exactly, by a factor of EᵀP E,
and B ≈ P⁻¹ takes the rest (balancing: J. M. Tang and others, J. Sci. Comput. 39, 2009):

    P⁻¹ ≈ Q + (I − Q P) B (I − P Q),    Q = E (EᵀP E)⁻¹ Eᵀ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.solvers.primal.elimination import factor

#: Weight of a term over the prior's from which on it is heavy [–]
HEAVY = 30.0

#: Most connected sets, the size of the factor
MOST_SETS = 30_000

#: Largest connected set over all voxels; on a larger one, nearly constant fields are
#: seen as little as the constant, and deflating the constant alone does not help [–]
LARGEST_SHARE = 0.5

#: Sums of a row below this part of the largest entry are zero [–]
ROUNDING = 1e-9

_Map = Callable[[Array], Array]


@dataclass(frozen=True)
class UnseenFields:
    """E, P E and a factor of EᵀP E.

    Attributes:
        fields: E, shape (V, k).
        images: P E, shape (V, k).
        solve: (EᵀP E)⁻¹.
    """

    fields: sp.csr_array = field(repr=False)
    images: sp.csr_array = field(repr=False)
    solve: _Map = field(repr=False)

    @classmethod
    def of(
        cls, prior: ProgramTerm, wide: Sequence[ProgramTerm], moving: Mask
    ) -> UnseenFields | None:
        """The null space that all heavy terms have in common.

        Args:
            prior: The Laplace term.
            wide: The wide terms.
            moving: Voxels whose value is not given, shape (V,).

        Returns:
            None if no term is heavy, if a heavy one has rows other than differences, or
            if the connected sets are single voxels or nearly the whole grid.
        """
        heavy = [
            t for t in wide if t.weight * (t.matrix.data**2).max(initial=0) > HEAVY
        ]
        if not heavy or not all(_is_of_differences(t.matrix) for t in heavy):
            return None
        sets = _indicators(joined([t.matrix for t in heavy]), moving)
        if sets is None or sets.shape[1] > MOST_SETS:
            return None
        images = sp.csr_array((len(moving), sets.shape[1]))
        for t in (prior, *wide):
            images = images + t.weight * (t.matrix.T @ (t.matrix @ sets))
        images = sp.csr_array(sp.diags_array(moving.astype(float)) @ images)
        images.eliminate_zeros()
        small = factor(sp.csc_array(sets.T @ images))
        return cls(sets, images, small.solve)

    def beside(self, prior: _Map, r: Array) -> Array:
        """P⁻¹r by deflation and B.

        Args:
            prior: B.
            r: Shape (V,).
        """
        own = self.solve(self.fields.T @ r)
        z = prior(r - self.images @ own)
        own = own - self.solve(self.images.T @ z)
        return np.asarray(z + self.fields @ own)


def _is_of_differences(M: sp.csr_array) -> bool:
    largest = float(np.abs(M.data).max(initial=0.0))
    return bool((np.abs(M.sum(axis=1)) <= ROUNDING * largest).all())


def joined(matrices: Sequence[sp.csr_array]) -> IntArray:
    """Number of every voxel's connected set, shape (V,); a row connects its voxels."""
    V, here, there = matrices[0].shape[1], [], []
    for M in matrices:
        row = np.repeat(np.arange(M.shape[0]), np.diff(M.indptr))
        next_to = row[1:] == row[:-1]
        here.append(M.indices[:-1][next_to])
        there.append(M.indices[1:][next_to])
    places = np.concatenate(here), np.concatenate(there)
    graph = sp.coo_array((np.ones(len(places[0])), places), shape=(V, V))
    _, label = connected_components(sp.csr_array(graph), directed=False)
    return np.asarray(label, dtype=np.int64)


def _indicators(label: IntArray, moving: Mask) -> sp.csr_array | None:
    """Indicator columns of connected sets, without single voxels and given values.

    None without any, or where one set exceeds `LARGEST_SHARE`.
    """
    sizes = np.bincount(label)
    kept = sizes > 1
    kept[label[~moving]] = False
    if not kept.any() or sizes[kept].max() > LARGEST_SHARE * len(label):
        return None
    at = np.flatnonzero(kept[label])
    places = at, (np.cumsum(kept) - 1)[label[at]]
    shape = len(moving), int(kept.sum())
    return sp.csr_array(sp.coo_array((np.ones(len(at)), places), shape=shape))
