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
from ttus_opt.solvers.primal.wide_term import WideTerm
from ttus_opt.voxmap.grid import CylindricalGrid, nodes_of

#: Rows of which the stencil of a term is learnt, and the longest row [–]
SAMPLE, LONGEST = 4000, 48
#: Waves per direction, from the longest to the shortest on the grid [–]
WAVES = 6
#: Strengths at which a term is fitted, and the least over the largest [–]
STRENGTHS, LEAST = 6, 1e-8
#: Steps of the fit
FIT_STEPS = 12
#: A symbol below this is zero [–]
ROUNDING = 1e-9
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
        # by number: to sort triples takes twenty times as long
        span = 2 * np.array(grid.shape) + 1
        number = np.ravel_multi_index(tuple((offsets + span // 2).T), tuple(span))
        codes, at = np.unique(number, return_inverse=True)
        unique = np.stack(np.unravel_index(codes, tuple(span)), -1) - span // 2
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

    def fit(self, b: Array, most: float = np.inf) -> Array:
        """Fit c and d along r, θ, z to a symbol b of B, shape (4,).

        The ratio of λ + X̂ to the root of λ² + b matters, too small as too large: the
        squares of its logarithm are made least, by Gauss and Newton's method.

        Args:
            b: At every wave, shape (n,).
            most: Most of c.
        """
        goal = np.sqrt(self.stiffness**2 + b)
        basis = np.column_stack([np.ones(len(b)), self.bend])
        found = _bounded(basis / goal[:, None], 1.0 - self.stiffness / goal, most)
        for _ in range(FIT_STEPS):
            now = self.stiffness + basis @ found
            slope = basis / now[:, None]
            full = _bounded(slope, slope @ found - np.log(now / goal), most)
            found = 0.5 * (found + full)
        return np.asarray(found)


def _bounded(matrix: Array, side: Array, most: float) -> Array:
    """Least squares over x ≥ 0, its first entry at most some number."""
    found = nnls(matrix, side)[0]
    if found[0] > most:
        found = np.r_[most, nnls(matrix[:, 1:], side - most * matrix[:, 0])[0]]
    return np.asarray(found)


@dataclass(frozen=True)
class Root:
    """X on the grid, times r as the symmetric block of L is.

    Attributes:
        added: What it adds to A; None for nothing.
        coupling: What it adds to L's entries in free rows and fixed columns, (V, V).
    """

    added: Added | None
    coupling: sp.csr_array = field(repr=False)


def matched_root(
    wide: Sequence[WideTerm],
    grid: CylindricalGrid,
    free: Mask,
    radii: Array,
    compliance: Array,
    unseen: bool = False,
) -> Root:
    """X of the wide terms.

    Args:
        wide: The wide terms.
        grid: The grid of the operator.
        free: Voxels with a Laplace row, shape (V,).
        radii: What turns a row of A into one of L, shape (V,) [m].
        compliance: Ω, shape (V,) [–].
        unseen: Whether fields that heavy terms do not see are solved for apart.
    """
    V = grid.n_voxels
    roots = (_root(term, grid, free, compliance, unseen) for term in wide)
    parts = [part for part in roots if part is not None]
    if not parts:
        return Root(None, sp.csr_array((V, V)))
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
    added = Added(grid.unflatten(np.where(free, screening * radii, 0.0)), used)
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
        values: d at every voxel, zero where a term is not, shape (V,).
        here: Voxels.
        there: The next ones; where the grid ends, the first.
        free: Voxels with a Laplace row, shape (V,).
        radii: What turns a row of A into one of L, shape (V,) [m].
    """
    a, b = (values * radii)[here], (values * radii)[there]
    both = np.minimum(a, b) > 0.0
    # between two free voxels as in series; what is fixed counts by its being there
    series = 2.0 * a * b / np.where(both, a + b, 1.0)
    one = np.where(free[here], a, b)
    link = np.where(free[here] & free[there], series, one)
    return np.asarray(np.where(both & (free[here] | free[there]), link, 0.0))


def _root(
    term: WideTerm, grid: CylindricalGrid, free: Mask, compliance: Array, unseen: bool
) -> Array | None:
    """Of one term c and d at every voxel, shape (4, V); None where it is nowhere."""
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
    most, held = np.inf, np.count_nonzero(~free & (compliance > 0.0))
    acting, every = np.count_nonzero(free & (strength > 0.0)), np.count_nonzero(free)
    blind = stencil.symbol(np.zeros((1, 3)))[0] < ROUNDING
    if held and blind and acting > 0.5 * every and not unseen:
        # all over the field, it does not see constants, which soft values alone hold,
        # and X would hold them at every voxel
        most = float(np.sqrt(held / every))
    fits = np.array([waves.fit(step * symbol, most) for step in steps])
    fits[:, 1:][fits[:, 1:] < NEGLIGIBLE * waves.own] = 0.0
    found = np.zeros((4, grid.n_voxels))
    # √ of the strength is what all of them are about proportional to
    root = np.sqrt(strength[at])
    for values, own in zip(found, fits.T, strict=True):
        if own.any():
            by_root = own / np.sqrt(steps)
            values[at] = np.interp(np.log(strength[at]), np.log(steps), by_root) * root
    return found
