"""Sparse sources exactly: an exchange method over columns of L⁻¹.

With given boundary values and p = p₀ + L⁻¹u the problem

    min_u  Σ_v c_v |u_v| + ½ ‖A u − s‖²,      A = D L⁻¹,  s = t − D p₀

(D the few rows times the roots of twice their weights) has a solution with few sources.
Its multiplier is η = Aᵀ(s − A u), |η_v| ≤ c_v, and η_v = c_v sign u_v at a source. From
no source on, voxels where |η| exceeds c in a local maximum become columns, the problem
over these columns is solved by an active set, and η is computed again: an exchange
method for semi-infinite programs (few dual unknowns, a constraint per voxel). A column
takes one solve with L, η one with Lᵀ; columns are solved in parallel, and both only as
accurately as the final check needs.

Source: R. Hettich, K. O. Kortanek, Semi-Infinite Programming (1993); C. L. Lawson,
R. J. Hanson, Solving Least Squares Problems (1974), chapter 23.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.ndimage import maximum_filter
from scipy.optimize import nnls

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import NumericalError
from ttus_opt.core.threads import side_by_side
from ttus_opt.laplace.system import RTOL, LaplaceSystem
from ttus_opt.solvers.base import is_late

#: Most exchanges, and most new columns of one
EXCHANGES, NEW = 100, 40

#: Part of c by which |η| may exceed it [–]
EXCESS = 1e-7

#: Relative residual of the first solves for columns and η [–]
LOOSE = 1e-8


class SourceExchange:
    """The sources of one problem.

    Attributes:
        solves: Solves with L or Lᵀ so far.
    """

    def __init__(
        self,
        laplace: LaplaceSystem,
        rows: sp.csr_array,
        target: Array,
        charge: Array,
        base: Array,
    ) -> None:
        """Start without a source.

        Args:
            laplace: L.
            rows: D, shape (m, V).
            target: t, shape (m,).
            charge: c of every voxel, infinite where its value is given, shape (V,).
            base: p₀, shape (V,).
        """
        self._laplace, self._rows, self._charge = laplace, rows, charge
        self._base, self._target = base, target
        self._left = target - rows @ base
        self._at: IntArray = np.zeros(0, dtype=np.int64)
        self._signs = np.zeros(0)
        self._columns = np.zeros((len(target), 0))
        self._sizes = np.zeros(0)
        self._rtol = LOOSE
        self.solves = 0

    @property
    def sources(self) -> int:
        """Number of sources."""
        return int((self._sizes > 0.0).sum())

    def run(self, excess: float, deadline: float | None) -> Array:
        """Exchange until |η| ≤ c (1 + excess).

        Args:
            excess: As `EXCESS` [–].
            deadline: `time.perf_counter` at which to stop; None for never [s].

        Returns:
            The field, shape (V,).
        """
        for _ in range(EXCHANGES):
            slope = self._slope(self._rest, self._rtol)
            wanted = self._wanted(slope, excess)
            if not len(wanted) or is_late(deadline):
                break
            before = len(self._at)
            self._add(wanted, np.sign(slope[wanted]))
            if len(self._at) == before:  # by rounding: all of them are columns already
                break
            self._solve()
        return self.field()

    def tighten(self, deadline: float | None) -> None:
        """Keep the present sources and compute their columns to full accuracy.

        Args:
            deadline: `time.perf_counter` after which nothing is done; None for never
                [s].
        """
        if is_late(deadline):
            return
        kept = self._sizes > 0.0
        self._rtol = RTOL
        self._at, self._signs = self._at[kept], self._signs[kept]
        self._sizes = self._sizes[kept]
        self._columns = self._columns_of(self._at, self._signs)
        if kept.any():
            self._solve()

    def field(self) -> Array:
        """The field p₀ + L⁻¹u, shape (V,)."""
        u = np.zeros(len(self._charge))
        np.add.at(u, self._at, self._signs * self._sizes)
        self.solves += 1
        return np.asarray(self._base + self._laplace.solve(u))

    def multipliers(self, field: Array) -> Array:
        """Multiplier η of every Laplace row, shape (V,).

        After `tighten` it follows from the columns, not from the field: with small
        charges the measured rows nearly hold, and their misfit at the field is rounding
        error of its solve.

        Args:
            field: The solution, shape (V,).
        """
        exact = self._rtol == RTOL
        return self._slope(self._rest if exact else self._target - self._rows @ field)

    @property
    def _rest(self) -> Array:
        """Residual s − A u, by the columns, shape (m,)."""
        return np.asarray(self._left - self._columns @ self._sizes)

    def _slope(self, rest: Array, rtol: float = RTOL) -> Array:
        """η = L⁻ᵀDᵀ rest, shape (V,)."""
        self.solves += 1
        return self._laplace.solve_adjoint(self._rows.T @ rest, rtol=rtol)

    def _wanted(self, slope: Array, excess: float) -> IntArray:
        """Local maxima of |η|/c above 1, the largest first."""
        over = np.abs(slope) / self._charge
        grid = self._laplace.grid
        around = maximum_filter(
            grid.unflatten(over), 3, mode=("nearest", "wrap", "nearest")
        )
        peak = (over >= grid.flatten(around)) & (over > 1.0 + excess)
        peak[self._at[self._sizes > 0.0]] = False
        found = np.flatnonzero(peak)
        if not len(found):  # only beside a present source
            over[self._at] = 0.0
            found = np.flatnonzero(over > 1.0 + excess)
        order = np.argsort(over[found])[::-1]
        return found[order[:NEW]]

    def _add(self, voxels: IntArray, signs: Array) -> None:
        """Add columns ± D L⁻¹ e, except those there are."""
        known = set(zip(self._at.tolist(), self._signs.tolist(), strict=True))
        pairs = zip(voxels.tolist(), signs.tolist(), strict=True)
        new = np.array([pair not in known for pair in pairs], dtype=bool)
        if not new.any():
            return
        columns = self._columns_of(voxels[new], signs[new])
        self._columns = np.column_stack([self._columns, columns])
        self._at = np.append(self._at, voxels[new])
        self._signs = np.append(self._signs, signs[new])
        self._sizes = np.append(self._sizes, np.zeros(columns.shape[1]))

    def _columns_of(self, voxels: IntArray, signs: Array) -> Array:
        """Columns ± D L⁻¹ e of some voxels, shape (m, k)."""

        def column(v: int, sign: float) -> Array:
            unit = np.zeros(len(self._charge))
            unit[v] = sign
            return np.asarray(self._rows @ self._laplace.solve(unit, rtol=self._rtol))

        self.solves += len(voxels)
        found = side_by_side(column, voxels.tolist(), signs.tolist())
        return np.column_stack([np.zeros((len(self._left), 0)), *found])

    def _solve(self) -> None:
        """Sizes ≥ 0 of the columns by an active set."""
        charge = self._charge[self._at]
        self._sizes = nonnegative_minimum(self._columns, self._left, charge)


def nonnegative_minimum(columns: Array, target: Array, charge: Array) -> Array:
    """The x ≥ 0 that minimises ½ ‖A x − s‖² + cᵀx (Lawson and Hanson's active set).

    The rest s − A x is the point nearest to s with Aᵀ(s − A x) ≤ c: a least-distance
    problem, which is one of least squares over x ≥ 0 with one more row.

    Args:
        columns: A, shape (m, k).
        target: s, shape (m,).
        charge: c, not negative, shape (k,).

    Raises:
        NumericalError: The active set did not settle.
    """
    size = float(np.linalg.norm(target)) or 1.0
    # of the same products, with at most k rows
    rows = np.asarray(np.linalg.qr(columns, mode="r"))
    gain = (columns.T @ target - charge) / size
    whole = np.vstack([-rows, gain])
    scale = np.linalg.norm(whole, axis=0)
    unit, most = np.append(np.zeros(len(rows)), 1.0), 20 * len(charge) + 20
    try:
        x = nnls(whole / scale, unit, maxiter=most)[0] / scale
    except RuntimeError as error:  # of its iterations
        raise NumericalError("the sizes of the sources did not settle") from error
    return np.asarray(x * size / (1.0 - float(gain @ x)))
