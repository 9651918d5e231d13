"""Newton steps with any sparse rows: preconditioned conjugate gradients.

The matrix is H = Σ MᵀC M over all rows, C their slopes. The preconditioner is its
diagonal until steps become many. Then every field has an operator of its own, for the
rows that lie over all voxels:

- where squares of Laplace's rows determine it: (L − X)ᵀΩ⁻¹(L − X), X matched to the
  others (`ttus_opt.solvers.primal.matching`);
- where they are differences of neighbours: their network of conductances, with rows
  beyond a kink cut (`ttus_opt.laplace.network`);
- otherwise a factor or algebraic multigrid (`ttus_opt.solvers.primal.sparse_inverse`).

Few rows are added by their Schur complement (`primal.preconditioner`). Slopes are those
without kinks, except in the network.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.compiled import compiled
from ttus_opt.core.errors import MissingPackageError
from ttus_opt.laplace.network import NeighbourRows, by_network
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.terms.penalties import Slope
from ttus_opt.solvers.conjugate_gradients import Map, to_residual
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.primal.approximate_system import ApproximateSystem
from ttus_opt.solvers.primal.preconditioner import with_few_rows
from ttus_opt.solvers.primal.sparse_inverse import SparseInverse
from ttus_opt.solvers.proximal.penalised_rows import Between
from ttus_opt.solvers.proximal.problem import PenalisedProblem

Indices = NDArray[np.int32] | NDArray[np.int64]

#: Relative residual of a step with kinks ahead, and of one that may be the last [–]
ROUGH, SQUARES = 1e-2, 1e-4

#: Most steps of conjugate gradients; steps after which the diagonal is too weak
MOST_STEPS, MANY = 400, 16

#: Factor by which σ may change before the preconditioner is rebuilt
KEEP = 1.5

#: Blocks with more rows are treated as lying over all voxels; squares alone if they are
#: no measurements and have at most so many entries per row [–]
FEW_ROWS, LONG = 4096, 64

#: Voxels from which squares alone are tried as a network before a factor [–]
NETWORK = 30_000


class FieldNewton:
    """Newton steps by preconditioned conjugate gradients over all variables.

    Attributes:
        rtol: Default relative residual of a step [–].
        description: The preconditioner, in words.
    """

    description = "the diagonal"

    def __init__(self, problem: PenalisedProblem, squares: bool = False) -> None:
        """Take the rows.

        Args:
            problem: The problem; an anchor has one row per variable.
            squares: Whether all penalties are squares, so that the preconditioner
                serves for good and is set up at the first step.
        """
        self._program, self._fixed = problem.program, problem.fixed
        self._held = np.flatnonzero(problem.fixed)
        self._blocks, self._anchor = problem.blocks, problem.anchor
        self._squares, self.rtol = squares, SQUARES if squares else ROUGH
        self._wide = [len(b.target) > FEW_ROWS for b in self._blocks]
        if squares:
            short = [not b.measured and b.nnz <= LONG for b in self._blocks]
            self._wide = short if any(short) else [True] * len(short)
        self._squared = [
            rows.matrix.multiply(rows.matrix).tocsr().T.tocsr() for rows in self._blocks
        ]
        self._by_operator = squares
        self._neighbours: dict[str, list[NeighbourRows]] = {}
        self._made: tuple[tuple[float, ...], Map] | None = None

    def step(
        self,
        gradient: Array,
        multipliers: Sequence[Array],
        slopes: Sequence[Slope],
        rtol: float,
        deadline: float | None,
    ) -> tuple[Array, int]:
        """As `LaplaceNewton.step`; the multipliers are not used."""
        side = np.where(self._fixed, 0.0, -gradient)

        def product(v: Array) -> Array:
            return self._product(v, slopes)

        precondition = self.preconditioner(slopes)
        run = to_residual(product, side, precondition, rtol, MOST_STEPS, deadline)
        if run.steps > MANY and not self._squares:  # too weak, or too many new slopes
            self._by_operator, self._made = True, None
        return run.y, run.steps

    def taken(self, length: float) -> None:
        """No state depends on the step length."""

    def preconditioner(self, slopes: Sequence[Slope]) -> Map:
        """The current one, rebuilt where σ has changed much.

        Raises:
            MissingPackageError: Squares alone need algebraic multigrid, and pyamg is
                not installed.
        """
        movable = (b for b in self._blocks if not b.exact or b is self._anchor)
        key = tuple(b.sigma for b in movable)
        if self._made is not None:
            old = np.array(self._made[0])
            ratio = np.array(key) / old
            if (ratio < KEEP).all() and (ratio > 1.0 / KEEP).all():
                return self._made[1]
        self._made = key, self._make(slopes)
        return self._made[1]

    def _make(self, slopes: Sequence[Slope]) -> Map:
        """The diagonal, or an operator for every field with few rows."""
        without_kinks = [
            slope
            if b.exact or isinstance(b.law, Between)
            else Slope(np.full_like(slope.factor, b.sigma))
            for b, slope in zip(self._blocks, slopes, strict=True)
        ]
        diagonal = self.diagonal(without_kinks)
        inverse = np.where(self._fixed, 0.0, 1.0 / np.where(diagonal, diagonal, 1.0))
        laplace = self._program.laplace
        parts = self._program.variables
        if laplace is None:
            parts = {"": slice(0, len(diagonal))} if self._squares else {}
        if not self._by_operator or not parts:
            return lambda v: inverse * v
        n = len(diagonal) if laplace is None else len(laplace.free)
        fields = [
            (part, self._of_field(name, part, slopes, without_kinks, diagonal))
            for name, part in parts.items()
            if part.stop - part.start == n
        ]

        def prior(v: Array) -> Array:
            z = inverse * v
            for part, apply in fields:
                z[part] = apply(v[part])
            z[self._held] = 0.0
            return z

        few = [
            _scaled(b.matrix, slope)
            for b, slope, wide in zip(self._blocks, slopes, self._wide, strict=True)
            if not wide
        ]
        if not few:
            return prior
        free = sp.diags_array((~self._fixed).astype(float))
        return with_few_rows(prior, sp.csr_array(sp.vstack(few) @ free))

    def _of_field(
        self,
        name: str,
        part: slice,
        slopes: Sequence[Slope],
        without_kinks: Sequence[Slope],
        diagonal: Array,
    ) -> Map:
        """The preconditioner of one field."""
        laplace, fixed = self._program.laplace, self._fixed[part]
        term = self._program.laplace_term_of(name) if name else None
        wide = [
            ProgramTerm(b.name, 1.0, _scaled(b.matrix[:, part], slope), b.target)
            for b, slope, is_wide in zip(
                self._blocks, without_kinks, self._wide, strict=True
            )
            if is_wide and b is not self._anchor
        ]
        if term is not None and term.weight > 0.0:
            rows = term.laplace_rows
            assert rows is not None
            system = rows.system or laplace
            scale = np.ones(len(fixed)) if rows.scale is None else rows.scale
            compliance = np.where(fixed, 0.0, 1.0 / (2.0 * term.weight * scale**2))
            others = [t for t in wide if t.name != term.name]
            nothing = sp.csr_array((0, len(fixed)))
            exact = DualSystem(system, compliance, nothing, np.zeros(0))
            return ApproximateSystem.matched(exact, others).prior
        if laplace is not None and not (self._squares and len(fixed) < NETWORK):
            network = by_network(laplace, *self._network(name, part, slopes), fixed)
            outside = bool((~laplace.free & ~fixed).any()) and self._squares
            if network is not None and not outside:
                self.description = "the grid's multigrid"
                return network
        anchored = 0.0 if self._anchor is None else 2.0 * self._anchor.weight
        return self._sparse(wide, fixed, diagonal[part], anchored)

    def _sparse(
        self, wide: list[ProgramTerm], fixed: Mask, diagonal: Array, anchored: float
    ) -> Map:
        """A factor or algebraic multigrid of the wide rows; or the diagonal."""
        moving = np.flatnonzero(~fixed)
        own = np.where(diagonal > 0.0, diagonal, 1.0)[moving]
        Q = sp.csr_array((len(moving), len(moving)))
        for term in wide:
            M = term.matrix[:, moving]
            Q = sp.csr_array(Q + M.T @ M)
        # a variable without such rows gets the diagonal of the few
        rest = np.where(Q.diagonal() > 0.0, anchored, own)
        try:
            inverse = SparseInverse.of(sp.csr_array(Q + sp.diags_array(rest)))
        except MissingPackageError:
            if self._squares:
                raise
            inverse = SparseInverse(lambda v: v / own, "the diagonal")
        self.description = inverse.description

        def apply(v: Array) -> Array:
            z = np.zeros_like(v)
            z[moving] = inverse.apply(v[moving])
            return z

        return apply

    def _network(
        self, name: str, part: slice, slopes: Sequence[Slope]
    ) -> tuple[Array, Array]:
        """Conductances of a field's wide rows, (3, V), and their diagonal, (V,)."""
        grid = self._program.laplace.grid
        wide = [k for k, wide in enumerate(self._wide) if wide]
        if name not in self._neighbours:
            self._neighbours[name] = [
                NeighbourRows.of(self._blocks[k].matrix[:, part], grid) for k in wide
            ]
        links, diagonal = np.zeros((3, grid.n_voxels)), np.zeros(grid.n_voxels)
        for k, rows in zip(wide, self._neighbours[name], strict=True):
            links += rows.links(slopes[k].factor, grid.n_voxels)
            diagonal += (self._squared[k] @ slopes[k].factor)[part]
        return links, diagonal

    def _product(self, v: Array, slopes: Sequence[Slope]) -> Array:
        """H v on the variables that are free."""
        out = np.zeros_like(v)
        for rows, slope, wide in zip(self._blocks, slopes, self._wide, strict=True):
            if rows is self._anchor:  # one row per variable
                out += slope.factor * v
            elif slope.along is None and wide:
                add_normal_product(out, rows.matrix, slope.factor, v)
            else:
                out += rows.matrix.T @ slope.times(rows.matrix @ v)
        out[self._held] = 0.0
        return out

    def diagonal(self, slopes: Sequence[Slope]) -> Array:
        """Diagonal of H, neglecting the directions ``along`` of groups, shape (n,)."""
        out = np.zeros(len(self._fixed))
        for square, slope in zip(self._squared, slopes, strict=True):
            out += square @ slope.factor
        return out


def _scaled(matrix: sp.csr_array, slope: Slope) -> sp.csr_array:
    """Rows times the roots of their slopes."""
    return sp.csr_array(sp.diags_array(np.sqrt(slope.factor)) @ matrix)


def add_normal_product(
    out: Array, matrix: sp.csr_array, slope: Array, v: Array
) -> None:
    """Add MᵀC M v to a vector, reading M once, rows without slope not at all.

    Two sparse products read it twice and store M v.

    Args:
        out: Changed, shape (n,).
        matrix: M, shape (m, n).
        slope: Diagonal of C, shape (m,).
        v: Shape (n,).
    """
    _add(matrix.indptr, matrix.indices, matrix.data, slope, v, out)


@compiled(nogil=True)
def _add(
    indptr: Indices, indices: Indices, data: Array, slope: Array, v: Array, out: Array
) -> None:
    """`add_normal_product` on the arrays of M in CSR (compiled)."""
    for row in range(slope.size):
        factor = slope[row]
        if factor == 0.0:
            continue
        start, end = indptr[row], indptr[row + 1]
        value = 0.0
        for k in range(start, end):
            value += data[k] * v[indices[k]]
        value *= factor
        for k in range(start, end):
            out[indices[k]] += value * data[k]
