"""A root X of the wide terms from the multigrid's own family: (L - X)ᵀ(L - X) for H.

H = LᵀΩ⁻¹L + B, B = Σ w MᵀM, has no multigrid of its own, but the square of an operator
that has one comes close to it (Pearson and Wathen, Numer. Linear Algebra Appl. 19,
2012): with -L and X positive and B = XᵀΩ⁻¹X

    ½ (‖L p‖² + ‖X p‖²)  ≤  ‖(L - X) p‖²  ≤  2 (‖L p‖² + ‖X p‖²)

but for what L and X fail to commute. The family is screening and conductances along
r, θ and z. What B is like is learnt from its rows: a sample of them gives the stencil
of B and its symbol b(f) at waves f, and X̂(f) = c + Σ_a d_a (2 - 2 cos f_a) with
c, d ≥ 0 is fitted so that (λ + X̂)² comes close to λ² + b at all waves that the grid can
carry, λ being the symbol of -L. The strength of B, and so c and d, may change from
voxel to voxel. Terms M that are themselves such operators are met exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.optimize import nnls

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.multigrid.coarsening import Added
from ttus_opt.solvers.primal.split import WideTerm
from ttus_opt.voxmap.grid import CylindricalGrid, nodes_of

#: Rows of which the stencil of a term is learnt, and the longest row [–]
SAMPLE, LONGEST = 4000, 48
#: Waves per direction, from the longest to the shortest on the grid [–]
WAVES = 6
#: Strengths at which a term is fitted, and the least over the largest [–]
STRENGTHS, LEAST = 9, 1e-8
#: Conductances below this part of L's own are left out [–]
NEGLIGIBLE = 0.02


@dataclass(frozen=True)
class _Stencil:
    """What B = w MᵀM looks like on average.

    Attributes:
        strength: Diagonal of B, shape (V,) [–].
        offsets: From voxel to voxel, in steps of the grid, shape (k, 3).
        values: Entries of B over its diagonal, shape (k,) [–].
    """

    strength: Array = field(repr=False)
    offsets: IntArray
    values: Array

    @classmethod
    def of(cls, term: WideTerm, grid: CylindricalGrid) -> _Stencil:
        M = term.matrix
        squares = np.bincount(M.indices, M.data**2, grid.n_voxels)
        strength = np.asarray(term.weight * squares)
        offsets, products = _pairs(M, grid)
        unique, at = np.unique(offsets, axis=0, return_inverse=True)
        sums = np.bincount(at.reshape(-1), products)
        own = sums[(unique == 0).all(axis=1)].sum()
        values = sums / own if own > 0.0 else sums
        return cls(strength, np.asarray(unique, dtype=np.int64), np.asarray(values))

    def symbol(self, waves: Array) -> Array:
        """b(f) over the diagonal at waves, shape (n, 3), in radians a step: (n,)."""
        b = np.cos(waves @ self.offsets.T.astype(float)) @ self.values
        return np.asarray(np.maximum(b, 0.0))


def _pairs(M: sp.csr_array, grid: CylindricalGrid) -> tuple[IntArray, Array]:
    """Offsets and products of entries that share a row, of a sample of rows."""
    length = np.diff(M.indptr)
    rows = np.flatnonzero((length > 0) & (length <= LONGEST))
    if len(rows) > SAMPLE:
        rows = np.random.default_rng(0).choice(rows, SAMPLE, replace=False)
    offsets, products = [np.zeros((0, 3), np.int64)], [np.zeros(0)]
    for n in np.unique(length[rows]):
        at = M.indptr[rows[length[rows] == n]][:, None] + np.arange(n)
        nodes = np.stack(nodes_of(M.indices[at], grid.shape), axis=-1)
        apart = nodes[:, None] - nodes[:, :, None]
        turn = grid.shape[1]
        apart[..., 1] = (apart[..., 1] + turn // 2) % turn - turn // 2
        values = M.data[at]
        offsets.append(apart.reshape(-1, 3))
        products.append((values[:, None] * values[:, :, None]).reshape(-1))
    return np.concatenate(offsets), np.concatenate(products)


@dataclass(frozen=True)
class _Waves:
    """Waves that the grid can carry.

    Attributes:
        waves: In radians a step, shape (n, 3).
        bend: 2 - 2 cos of them: what a unit conductance makes, shape (n, 3) [–].
        stiffness: -L's symbol λ, shape (n,) [–].
        own: L's conductances along r, θ and z [–].
    """

    waves: Array = field(repr=False)
    bend: Array = field(repr=False)
    stiffness: Array = field(repr=False)
    own: Array

    @classmethod
    def of(cls, grid: CylindricalGrid, where: Array) -> _Waves:
        """Waves around voxels that are weighted by ``where``, shape (V,)."""
        share = grid.unflatten(where).sum(axis=(1, 2))
        arc = (grid.r_step / (grid.r * grid.theta_step)) ** 2
        theta = float(np.exp(np.average(np.log(arc), weights=share)))
        own = np.array([1.0, theta, (grid.r_step / grid.z_step) ** 2])
        # about half of the layers are inside
        longest = np.pi / np.array([max(grid.shape[0] // 2, 2), *grid.shape[1:]])
        each = [np.geomspace(f, np.pi, WAVES) for f in longest]
        waves = np.stack(np.meshgrid(*each, indexing="ij"), axis=-1).reshape(-1, 3)
        bend = 2.0 - 2.0 * np.cos(waves)
        return cls(waves, bend, bend @ own, own)

    def fit(self, b: Array) -> Array:
        """Fit c and d along r, θ, z to a symbol b of B, shape (4,)."""
        goal = np.sqrt(self.stiffness**2 + b)
        basis = np.column_stack([np.ones(len(b)), self.bend]) / goal[:, None]
        found, _ = nnls(basis, 1.0 - self.stiffness / goal)
        return np.asarray(found)


def matched_root(
    wide: Sequence[WideTerm],
    grid: CylindricalGrid,
    free: Mask,
    radii: Array,
    compliance: Array,
) -> Added | None:
    """X of the wide terms, times -r as the symmetric block of L is.

    Args:
        wide: The wide terms.
        grid: The grid.
        free: Voxels with a Laplace row, shape (V,).
        radii: What turns a row of A into one of L, shape (V,) [m].
        compliance: Ω, shape (V,) [–].

    Returns:
        What is added to A; None for nothing.
    """
    roots = (_root(term, grid, free, compliance) for term in wide)
    parts = [part for part in roots if part is not None]
    if not parts:
        return None
    total = np.sum(parts, axis=0) * np.where(free, radii, 0.0)
    screening, *links = (grid.unflatten(values) for values in total)
    used = tuple(links) if any(link.any() for link in links) else ()
    return Added(screening, used)


def _root(
    term: WideTerm, grid: CylindricalGrid, free: Mask, compliance: Array
) -> Array | None:
    """Of one term c and d at every voxel, shape (4, V); None where it is nowhere."""
    stencil = _Stencil.of(term, grid)
    strength = np.where(free, compliance * stencil.strength, 0.0)
    largest = float(strength.max(initial=0.0))
    if largest == 0.0:
        return None
    waves = _Waves.of(grid, strength)
    symbol = stencil.symbol(waves.waves)
    steps = largest * np.geomspace(LEAST, 1.0, STRENGTHS)
    fits = np.array([waves.fit(step * symbol) for step in steps])
    fits[:, 1:][fits[:, 1:] < NEGLIGIBLE * waves.own] = 0.0
    found = np.zeros((4, grid.n_voxels))
    at = np.flatnonzero(strength)
    # √ of the strength is what all of them are about proportional to
    root = np.sqrt(strength[at])
    for values, own in zip(found, fits.T, strict=True):
        if own.any():
            per_root = np.interp(
                np.log(strength[at]), np.log(steps), own / np.sqrt(steps)
            )
            values[at] = per_root * root
    return found
