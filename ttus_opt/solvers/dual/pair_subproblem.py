"""The subproblem of a working set of two fields.

Each voxel v has an unknown x_v of the first field and y_v of the second, a spoke of two
voxels to `subproblem.Blocks`: an active bound or a given value holds its value; with an
active link x_v - y_v ≥ s, y_v follows x_v. With (x, y) = P z + o, the remaining problem
has the same structure and no limits:

- free unknowns keep their own Laplace rows, which form the square system;
- the row of a held value becomes a measured row, and so does that of a y_v that follows
  x_v.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.laplace.multigrid import Multigrid
from ttus_opt.laplace.system import BlockSystem, LaplaceSystem
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.linear_parameters import LinearParameters
from ttus_opt.solvers.dual.pair_laplace import PairBlock
from ttus_opt.solvers.dual.solver import Accuracy, DualAnswer, DualSolver
from ttus_opt.solvers.dual.subproblem import Blocks
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.dual.working_set import WorkingSet


@dataclass(frozen=True)
class PairRows:
    """The objective of two fields, Σ (L x + B c - b)²/ω + ‖w (D x) + E c - t‖².

    Attributes:
        laplace: The system of one field.
        L: The operator of both fields in their units, block-diagonal, (2V, 2V).
        compliance: ω, 0 where a row must hold exactly, shape (2V,).
        b: Right-hand side, shape (2V,).
        column: B, column of an unknown c beside the fields, shape (2V,).
        rows: D, measured rows without weights, shape (m, 2V).
        root_weights: w, shape (m,).
        t: Weighted targets, shape (m,).
        measured_column: E, shape (m,).
        bounds: Bounds of c.
    """

    laplace: LaplaceSystem
    L: sp.csr_array = field(repr=False)
    compliance: Array = field(repr=False)
    b: Array = field(repr=False)
    column: Array = field(repr=False)
    rows: sp.csr_array = field(repr=False)
    root_weights: Array = field(repr=False)
    t: Array = field(repr=False)
    measured_column: Array = field(repr=False)
    bounds: tuple[float, float]

    @cached_property
    def neighbours(self) -> sp.csr_array:
        """The sparsity pattern of L."""
        pattern = np.ones(self.L.nnz, dtype=np.int8), self.L.indices, self.L.indptr
        return sp.csr_array(pattern, shape=self.L.shape)

    def parameter(self, x: Array) -> float:
        """The optimal c within its bounds for given fields, (2V,)."""
        return self.parameter_and_slope(x)[0]

    def parameter_and_slope(self, x: Array) -> tuple[float, float]:
        """That c, and the derivative of half the objective in c there."""
        soft = self.compliance > 0.0
        root = 1.0 / np.sqrt(self.compliance[soft])
        column = np.concatenate([root * self.column[soft], self.measured_column])
        misfit = np.concatenate(
            [
                root * (self.b - self.L @ x)[soft],
                self.t - self.root_weights * (self.rows @ x),
            ]
        )
        square, along = float(column @ column), float(column @ misfit)
        best = along / square if square > 0.0 else 0.0
        c = float(np.clip(best, *self.bounds))
        return c, (c - best) * square


class PairSubproblem:
    """The problem of one working set, and the solver of its dual."""

    def __init__(
        self,
        whole: PairRows,
        limits: SpokeLimits,
        active: WorkingSet,
    ) -> None:
        """Reduce the problem.

        Args:
            whole: The objective.
            limits: Its limits; a pair is treated as a spoke of two voxels.
            active: Which of them are active.
        """
        every = np.ones(len(whole.b), dtype=bool)
        unknowns = Blocks.of(every, limits, active)
        self._whole, self._unknowns = whole, unknowns
        own = unknowns.own
        rest = whole.b - whole.L @ unknowns.offset
        left = ~own & (whole.compliance > 0.0)
        at = np.flatnonzero(left)
        L = sp.csr_array(whole.L[at] @ unknowns.expansion)
        moved = np.diff(L.indptr) > 0
        left[at] = ~moved
        alone = self._alone(whole, rest, left)
        at, L = at[moved], L[moved]
        root = 1.0 / np.sqrt(whole.compliance[at])
        rows = [whole.rows @ unknowns.expansion, L, sp.csr_array((1, len(own)))]
        system = DualSystem(
            _laplace(whole, unknowns),
            np.where(own, whole.compliance, 0.0),
            sp.csr_array(sp.vstack(rows, format="csr")),
            np.concatenate([whole.root_weights, root, [1.0]]),
            len(whole.root_weights),
        )
        measured = whole.t - whole.root_weights * (whole.rows @ unknowns.offset)
        self._b = np.where(own, rest, 0.0)
        self._t = np.concatenate([measured, root * rest[at], alone[1:]])
        # c becomes a column of the measured rows only, by subtracting the fields that
        # it causes
        column = np.concatenate(
            [whole.measured_column, root * whole.column[at], alone[:1]]
        )
        self._made = system.laplace.solve(np.where(own, whole.column, 0.0))
        column -= system.measure(self._made)
        c = LinearParameters(column[:, None], *np.array(whole.bounds)[:, None])
        self._solver = DualSolver(system, c)

    @staticmethod
    def _alone(whole: PairRows, rest: Array, still: Mask) -> Array:
        """E and t of one row for the rows of voxels held with all their neighbours."""
        root = 1.0 / np.sqrt(whole.compliance[still])
        column, target = (root * v[still] for v in (whole.column, rest))
        size = float(np.linalg.norm(column))
        return np.array([size, float(column @ target) / size if size > 0.0 else 0.0])

    def solve(self, accuracy: Accuracy, last: Array | None) -> DualAnswer:
        """The minimiser of the working set, c started from that of the last one."""
        near = 0.0 if last is None else self._whole.parameter(last)
        # if c started at a bound and left it, all directions would be lost
        at_bound = last is not None and near in self._whole.bounds
        at = None if at_bound else np.array([near])
        answer = self._solver.solve(self._b, self._t, accuracy, at)
        z = answer.p - answer.c[0] * self._made
        p = np.asarray(self._unknowns.expansion @ z + self._unknowns.offset)
        return replace(answer, p=p)


def _laplace(whole: PairRows, unknowns: Blocks) -> BlockSystem:
    """The square system of a subproblem."""
    one = whole.laplace
    V = len(one.free)
    free = np.tile(one.free, 2) & unknowns.own
    radii = np.tile(one.radii, 2)
    # rows of free entries next to entries that are not free
    near = whole.neighbours @ (~free).astype(np.int8) > 0
    at = np.flatnonzero(free & near)
    L = sp.csr_array(whole.L[at] @ unknowns.expansion)
    row = np.repeat(at, np.diff(L.indptr))
    inward = ~free[L.indices]
    across = ~inward & (row >= V) & (L.indices < V)
    coupling = sp.csr_array(
        (L.data[inward], (row[inward], L.indices[inward])), shape=(2 * V, 2 * V)
    )
    entries = -radii[row[across]] * L.data[across]
    block = PairBlock(
        _multigrid(one, free[:V]),
        _multigrid(one, free[V:]),
        sp.csr_array((entries, (row[across] - V, L.indices[across])), shape=(V, V)),
    )
    return BlockSystem(free, radii, (coupling, sp.csr_array(coupling.T)), block)


def _multigrid(laplace: LaplaceSystem, free: Mask) -> Multigrid:
    """Solver of one field's block; that of the whole problem if nothing is held."""
    if np.array_equal(free, laplace.free):
        return laplace.multigrid
    grid = laplace.grid
    return Multigrid(grid, grid.unflatten(free), added=laplace.added)
