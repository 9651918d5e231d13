"""Newton steps with any sparse rows: preconditioned conjugate gradients.

The matrix is H = Σ MᵀC M over all rows, C their slopes. The preconditioner is its
diagonal until steps become many, then a multigrid with a Schur complement for the few
rows of large weight (`field_preconditioner`). Small problems are factorised.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ttus_opt.core.arrays import Array
from ttus_opt.laplace.network import NeighbourRows, by_network
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.terms.penalties.base import Slope
from ttus_opt.solvers.conjugate_gradients import Map, to_residual
from ttus_opt.solvers.primal.normal_product import add_normal_product
from ttus_opt.solvers.proximal.field_preconditioner import (
    by_differences,
    by_laplace,
    with_few_rows,
)
from ttus_opt.solvers.proximal.penalised_rows import (
    Between,
    PenalisedRows,
    group_columns,
)
from ttus_opt.solvers.proximal.problem import PenalisedProblem

#: Up to how many variables H is formed and factorised
SMALL = 3000

#: Most steps of conjugate gradients; steps after which the multigrid takes over
MOST_STEPS, MANY = 400, 16

#: Factor by which σ may change before the preconditioner is rebuilt
KEEP = 1.5

#: Blocks with more rows are treated as lying over all voxels
FEW_ROWS = 4096


class FieldNewton:
    """Newton steps by preconditioned conjugate gradients over all variables.

    Attributes:
        rtol: Default relative residual of a step [–].
    """

    rtol = 1e-2

    def __init__(self, problem: PenalisedProblem, anchor: PenalisedRows | None) -> None:
        """Take the rows.

        Args:
            problem: The problem.
            anchor: Rows of the proximal term, one per variable; None for none.
        """
        self._program, self._fixed = problem.program, problem.fixed
        self._held = np.flatnonzero(problem.fixed)
        self._anchor = anchor
        self._blocks = [*problem.blocks, *([] if anchor is None else [anchor])]
        self._squared = [
            rows.matrix.multiply(rows.matrix).tocsr().T.tocsr() for rows in self._blocks
        ]
        self._by_multigrid = False
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
        if len(side) <= SMALL:
            return self._factorised(side, slopes), 1

        def product(v: Array) -> Array:
            return self._product(v, slopes)

        precondition = self._preconditioner(slopes)
        run = to_residual(product, side, precondition, rtol, MOST_STEPS, deadline)
        if run.steps > MANY:  # the diagonal is too weak, or too many slopes changed
            self._by_multigrid, self._made = True, None
        return run.y, run.steps

    def taken(self, length: float) -> None:
        """No state depends on the step length."""

    def _preconditioner(self, slopes: Sequence[Slope]) -> Map:
        """The current one, rebuilt where σ has changed much."""
        key = tuple(b.sigma for b in self._blocks if not b.exact)
        if self._anchor is not None:
            key += (self._anchor.weight,)
        if self._made is not None:
            old = np.array(self._made[0])
            ratio = np.array(key) / old
            if (ratio < KEEP).all() and (ratio > 1.0 / KEEP).all():
                return self._made[1]
        self._made = key, self._make(slopes)
        return self._made[1]

    def _make(self, slopes: Sequence[Slope]) -> Map:
        """The diagonal, or a multigrid with few rows."""
        without_kinks = [
            slope
            if b.exact or isinstance(b.law, Between)
            else Slope(np.full_like(slope.factor, b.sigma))
            for b, slope in zip(self._blocks, slopes, strict=True)
        ]
        diagonal = self.diagonal(without_kinks)
        inverse = np.where(self._fixed, 0.0, 1.0 / np.where(diagonal, diagonal, 1.0))
        laplace = self._program.laplace
        if not self._by_multigrid or laplace is None:
            return lambda v: inverse * v
        fields = [
            (part, self._of_field(name, part, slopes, without_kinks, diagonal))
            for name, part in self._program.variables.items()
            if part.stop - part.start == len(laplace.free)
        ]

        alone = np.ones(len(diagonal), dtype=bool)
        for part, _ in fields:
            alone[part] = False
        rest = np.flatnonzero(alone)

        def prior(v: Array) -> Array:
            z = np.empty_like(v)
            z[rest] = inverse[rest] * v[rest]
            for part, apply in fields:
                z[part] = apply(v[part])
            z[self._held] = 0.0
            return z

        few = [
            sp.diags_array(np.sqrt(slope.factor)) @ b.matrix
            for b, slope in zip(self._blocks, slopes, strict=True)
            if not self._is_wide(b)
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
        term = self._program.laplace_term_of(name)
        pairs = list(zip(self._blocks, without_kinks, strict=True))
        if term is not None and term.weight > 0.0:
            rows = term.laplace_rows
            assert rows is not None
            system = rows.system or laplace
            scale = np.ones(len(fixed)) if rows.scale is None else rows.scale
            compliance = np.where(fixed, 0.0, 1.0 / (2.0 * term.weight * scale**2))
            wide = [
                ProgramTerm(b.name, 1.0, _scaled(b.matrix[:, part], slope), b.target)
                for b, slope in pairs
                if self._is_wide(b) and b.name != term.name
            ]
            return by_laplace(system, compliance, wide)
        network = by_network(laplace, *self._network(name, part, slopes), fixed)
        if network is not None:
            return network
        anchored = 0.0
        if self._anchor is not None:
            anchored = 2.0 * self._anchor.weight
        return by_differences(laplace, diagonal[part] - anchored, anchored, fixed)

    def _network(
        self, name: str, part: slice, slopes: Sequence[Slope]
    ) -> tuple[Array, Array]:
        """Conductances of a field's wide rows, (3, V), and their diagonal, (V,)."""
        grid = self._program.laplace.grid
        wide = [k for k, b in enumerate(self._blocks) if self._is_wide(b)]
        if name not in self._neighbours:
            self._neighbours[name] = [
                NeighbourRows.of(self._blocks[k].matrix[:, part], grid) for k in wide
            ]
        links, diagonal = np.zeros((3, grid.n_voxels)), np.zeros(grid.n_voxels)
        for k, rows in zip(wide, self._neighbours[name], strict=True):
            links += rows.links(slopes[k].factor, grid.n_voxels)
            diagonal += (self._squared[k] @ slopes[k].factor)[part]
        return links, diagonal

    def _is_wide(self, block: PenalisedRows) -> bool:
        return len(block.target) > FEW_ROWS

    def _product(self, v: Array, slopes: Sequence[Slope]) -> Array:
        """H v on the variables that are free."""
        out = np.zeros_like(v)
        for rows, slope in zip(self._blocks, slopes, strict=True):
            if rows is self._anchor:  # one row per variable
                out += slope.factor * v
            elif slope.along is None and self._is_wide(rows):
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

    def _factorised(self, side: Array, slopes: Sequence[Slope]) -> Array:
        """The step of a small problem, by a factor of H."""
        free = np.flatnonzero(~self._fixed)
        H = sp.csr_array((len(side),) * 2)
        for rows, slope in zip(self._blocks, slopes, strict=True):
            H = H + rows.matrix.T @ _matrix(slope) @ rows.matrix
        own = sp.csc_array(H[free][:, free])
        tiny = np.finfo(float).eps * float(abs(own.diagonal()).max(initial=0.0))
        own = own + sp.csc_array(sp.eye_array(len(free)) * tiny)
        d = np.zeros_like(side)
        d[free] = splu(own).solve(side[free])
        return d


def _scaled(matrix: sp.csr_array, slope: Slope) -> sp.csr_array:
    """Rows times the roots of their slopes."""
    return sp.csr_array(sp.diags_array(np.sqrt(slope.factor)) @ matrix)


def _matrix(slope: Slope) -> sp.csr_array:
    """A slope as a matrix, shape (m, m)."""
    factor = sp.csr_array(sp.diags_array(slope.factor))
    if slope.along is None:
        return factor
    unit = group_columns(np.sqrt(slope.factor) * slope.along, slope.size)
    return sp.csr_array(factor - unit @ unit.T)
