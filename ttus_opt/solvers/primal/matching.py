"""Matching: H ≈ (L - X)ᵀ(L - X), X a root of the wide terms that multigrid can solve.

H = LᵀΩ⁻¹L + B, B = Σ w MᵀM, has no multigrid, but the square of an operator that has
one is close to it (Pearson and Wathen, Numer. Linear Algebra Appl. 19, 2012): with -L
and X positive and B = XᵀΩ⁻¹X

    ½ (‖L p‖² + ‖X p‖²)  ≤  ‖(L - X) p‖²  ≤  2 (‖L p‖² + ‖X p‖²)

as far as L and X commute. X consists of screening and of conductances along r, θ and z.
A sample of rows gives the stencil of B and its symbol b(f) at waves f; with λ the
symbol of -L, X̂(f) = c + Σ_a d_a (2 - 2 cos f_a), c, d ≥ 0, is fitted so that (λ + X̂)²
is close to λ² + b at all waves on the grid. The strength of B, and with it c and d, may
vary from voxel to voxel. Terms M of this form are matched exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.optimize import nnls

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.laplace.multigrid import Added
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.voxmap.grid import CylindricalGrid, nodes_of

#: Rows sampled for the stencil of a term, and the longest of them [–]
SAMPLE, LONGEST = 4000, 48
#: Waves per direction, from the longest to the shortest on the grid [–]
WAVES = 6
#: Strengths at which a term is fitted, and the least over the largest [–]
STRENGTHS, LEAST = 6, 1e-8
#: A symbol below this is zero [–]
ROUNDING = 1e-9


@dataclass(frozen=True)
class _Stencil:
    """The average stencil of B = w MᵀM.

    Attributes:
        strength: Diagonal of B, shape (V,) [–].
        offsets: Offsets in steps of the grid, shape (k, 3).
        values: Entries of B over its diagonal, shape (k,) [–].
    """

    strength: Array = field(repr=False)
    offsets: IntArray
    values: Array

    @classmethod
    def of(cls, term: ProgramTerm, grid: CylindricalGrid) -> _Stencil:
        M = term.matrix
        strength = term.weight * term.column_squares()
        offsets, products = _pairs(M, grid)
        # as one number: sorting triples takes twenty times as long
        span = 2 * np.array(grid.shape) + 1
        number = np.ravel_multi_index(tuple((offsets + span // 2).T), tuple(span))
        codes, at = np.unique(number, return_inverse=True)
        unique = np.stack(np.unravel_index(codes, tuple(span)), -1) - span // 2
        sums = np.bincount(at.reshape(-1), products)
        own = sums[(unique == 0).all(axis=1)].sum()
        values = sums / own if own > 0.0 else sums
        return cls(strength, np.asarray(unique, dtype=np.int64), np.asarray(values))

    def symbol(self, waves: Array) -> Array:
        """Symbol b over the diagonal, (n,), at waves of shape (n, 3) [rad per step]."""
        b = np.cos(waves @ self.offsets.T.astype(float)) @ self.values
        return np.asarray(np.maximum(b, 0.0))


def _pairs(M: sp.csr_array, grid: CylindricalGrid) -> tuple[IntArray, Array]:
    """Offsets and products of entries in the same row, over a sample of rows."""
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
    """Waves on the grid.

    Attributes:
        waves: Shape (n, 3) [rad per step].
        bend: 2 - 2 cos f, the symbol of a unit conductance, shape (n, 3) [–].
        stiffness: λ, the symbol of -L, shape (n,) [–].
    """

    waves: Array = field(repr=False)
    bend: Array = field(repr=False)
    stiffness: Array = field(repr=False)

    @classmethod
    def of(cls, grid: CylindricalGrid, where: Array) -> _Waves:
        """Waves for the mean radius of the voxels weighted by ``where``, shape (V,)."""
        share = grid.unflatten(where).sum(axis=(1, 2))
        arc = (grid.r_step / (grid.r * grid.theta_step)) ** 2
        theta = float(np.exp(np.average(np.log(arc), weights=share)))
        own = np.array([1.0, theta, (grid.r_step / grid.z_step) ** 2])
        # about half of the layers are inside
        longest = np.pi / np.array([max(grid.shape[0] // 2, 2), *grid.shape[1:]])
        each = [np.geomspace(f, np.pi, WAVES) for f in longest]
        waves = np.stack(np.meshgrid(*each, indexing="ij"), axis=-1).reshape(-1, 3)
        bend = 2.0 - 2.0 * np.cos(waves)
        return cls(waves, bend, bend @ own)

    def fit(self, b: Array, most: float = np.inf) -> Array:
        """Fit c and d along r, θ, z to a symbol b of B, shape (4,).

        Least squares of (λ + X̂)/√(λ² + b) − 1.

        Args:
            b: At every wave, shape (n,).
            most: Upper limit of c.
        """
        goal = np.sqrt(self.stiffness**2 + b)
        basis = np.column_stack([np.ones(len(b)), self.bend])
        matrix, side = basis / goal[:, None], 1.0 - self.stiffness / goal
        found = nnls(matrix, side)[0]
        if found[0] > most:
            found = np.r_[most, nnls(matrix[:, 1:], side - most * matrix[:, 0])[0]]
        return np.asarray(found)


@dataclass(frozen=True)
class Root:
    """X on the grid, times r like the symmetric block A of L.

    Attributes:
        added: Added to the block A of the grid, cut links included.
        coupling: Added to L's entries in free rows and fixed columns, (V, V).
    """

    added: Added
    coupling: sp.csr_array = field(repr=False)


def matched_root(
    wide: Sequence[ProgramTerm],
    laplace: LaplaceSystem,
    compliance: Array,
    unseen: bool = False,
) -> Root:
    """X of the wide terms.

    Args:
        wide: The wide terms.
        laplace: L.
        compliance: Ω, shape (V,) [–].
        unseen: Whether the null space of heavy terms is deflated (`UnseenFields`).
    """
    grid, free, radii = laplace.operator_grid, laplace.free, laplace.radii
    V = grid.n_voxels
    roots = (_root(term, grid, free, compliance, unseen) for term in wide)
    parts = [part for part in roots if part is not None]
    if not parts:
        return Root(Added(grounds=laplace.grounds), sp.csr_array((V, V)))
    screening, *conductances = np.sum(parts, axis=0)
    index = grid.unflatten(np.arange(V))
    links, rows, columns, entries = [], [], [], []
    for axis, values in enumerate(conductances):
        here, there = index.reshape(-1), np.roll(index, -1, axis).reshape(-1)
        if not values.any():
            links.append(np.zeros(grid.shape))
            continue
        link = _links(values, here, there, free, radii)
        links.append(grid.unflatten(link))
        for own, other in ((here, there), (there, here)):
            at = np.flatnonzero(free[own] & ~free[other] & (link > 0.0))
            rows.append(own[at])
            columns.append(other[at])
            entries.append(link[at] / radii[own[at]])
    used = tuple(links) if rows else ()
    own = grid.unflatten(np.where(free, screening * radii, 0.0))
    added = Added(own, used, laplace.grounds)
    if not rows:
        return Root(added, sp.csr_array((V, V)))
    places = np.concatenate(rows), np.concatenate(columns)
    coupling = sp.coo_array((np.concatenate(entries), places), shape=(V, V))
    return Root(added, sp.csr_array(coupling))


def _links(
    values: Array, here: IntArray, there: IntArray, free: Mask, radii: Array
) -> Array:
    """Conductances from voxels to the next ones, shape (V,) [m].

    Args:
        values: d at every voxel, zero outside the term, shape (V,).
        here: Voxels.
        there: The next ones; the first one at the end of the grid.
        free: Voxels with a Laplace row, shape (V,).
        radii: As in `SquareSystem`, shape (V,) [m].
    """
    a, b = (values * radii)[here], (values * radii)[there]
    both = np.minimum(a, b) > 0.0
    # in series between two free voxels; at a fixed voxel the free one's alone
    series = 2.0 * a * b / np.where(both, a + b, 1.0)
    one = np.where(free[here], a, b)
    link = np.where(free[here] & free[there], series, one)
    return np.asarray(np.where(both & (free[here] | free[there]), link, 0.0))


def _root(
    term: ProgramTerm,
    grid: CylindricalGrid,
    free: Mask,
    compliance: Array,
    unseen: bool,
) -> Array | None:
    """Fields c and d of one term, shape (4, V); None where it touches no free voxel."""
    stencil = _Stencil.of(term, grid)
    soft = np.where(compliance > 0.0, compliance, 1.0)
    strength = soft * stencil.strength
    largest = float(strength[free].max(initial=0.0))
    if largest == 0.0:
        return None
    strength = np.minimum(strength, largest)
    waves = _Waves.of(grid, np.where(free, strength, 0.0))
    symbol = stencil.symbol(waves.waves)
    at = np.flatnonzero(strength)
    least = max(float(strength[at].min()), LEAST * largest)
    steps = np.geomspace(least, largest, STRENGTHS if least < 0.9 * largest else 1)
    most, soft_values = np.inf, np.count_nonzero(~free & (compliance > 0.0))
    acting, every = np.count_nonzero(free & (strength > 0.0)), np.count_nonzero(free)
    blind = stencil.symbol(np.zeros((1, 3)))[0] < ROUNDING
    if soft_values and blind and acting > 0.5 * every and not unseen:
        # only soft values determine a constant, which the term does not see; without
        # the limit X would penalise it at every voxel
        most = float(np.sqrt(soft_values / every))
    fits = np.array([waves.fit(step * symbol, most) for step in steps])
    found = np.zeros((4, grid.n_voxels))
    # all of them are about proportional to the root of the strength
    root = np.sqrt(strength[at])
    for values, own in zip(found, fits.T, strict=True):
        if own.any():
            by_root = own / np.sqrt(steps)
            values[at] = np.interp(np.log(strength[at]), np.log(steps), by_root) * root
    return found
