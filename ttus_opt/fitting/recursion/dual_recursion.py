"""The dual system of eq. 10 with added and removed rows (docs/method, "Recursion").

With D the weighted measured rows, t their targets, p₀ = L⁻¹b and K = D L⁻¹L⁻ᵀDᵀ, the
minimiser of ‖L p - b‖² + ‖D p - t‖² is

    p = p₀ + L⁻¹L⁻ᵀDᵀ y,    (I + K) y = d₀,    d₀ = t - D p₀.

A measurement adds rows h to D. Their columns of K are D L⁻¹L⁻ᵀhᵀ: one solve with Lᵀ and
one with L per row. This is the Sherman-Morrison-Woodbury recursion without the dense V
× rows matrix L⁻¹L⁻ᵀDᵀ: only D (sparse), a low-rank factor R with K ≈ R Rᵀ and its basis
are kept (`fitting.recursion.low_rank_kernel`).

With p ~ Normal(p₀, (LᵀL)⁻¹) and noise of variance 1 on every weighted row, the same
quantities predict a measurement before it is added. With r its coordinates in the
columns of R, its innovation has the covariance

    S = I + h L⁻¹L⁻ᵀhᵀ - r rᵀ + r M⁻¹rᵀ,    M = I + RᵀR,

and its prediction is h p₀ + r M⁻¹Rᵀd₀.

R need not be exact: I + R Rᵀ is a preconditioner, and conjugate gradients refine the
field until (I + K) y = d₀ holds.

Rows may be added, faded and removed any number of times. When so many were removed that
R's basis settles, the columns of K of the rows that join it are solved for, so that
errors of R do not accumulate. If R becomes ill-conditioned, it is recomputed from D.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError, NumericalError
from ttus_opt.core.threads import side_by_side
from ttus_opt.fitting.recursion.low_rank_kernel import (
    LowRankKernel,
    Projection,
    update,
)
from ttus_opt.fitting.recursion.measured_rows import Block, MeasuredRows
from ttus_opt.gaussian.prior import LaplacePrior

if TYPE_CHECKING:
    from ttus_opt.laplace.system import LaplaceSystem

#: Largest residual variance of a dependent row, over that of its noise
DEPENDENT = 1e-6

#: Largest relative residual of the solves for columns of K, and the factor by which
#: their error, about this residual times ‖h‖², must stay below `DEPENDENT`
COLUMN_RTOL, MARGIN = 1e-7, 100.0

#: Relative residual of (I + K) y = d₀ to which the field is refined; most iterations
FIELD_RTOL, FIELD_ROUNDS = 1e-9, 30

#: Least Schur complement, exactly at least 1; below, rounding errors dominate
LEAST_SCHUR = 0.9


@dataclass(frozen=True)
class Forecast:
    """Prediction of a block of m new rows from the n rows held.

    Attributes:
        block: The rows h.
        projection: The rows projected on R's columns.
        columns: Entries of K of the chosen rows with those held, shape (p, n).
        prior: h p₀, shape (m,).
        mean: Predicted measurement, shape (m,).
    """

    block: Block
    projection: Projection
    columns: Array
    prior: Array
    mean: Array

    @property
    def schur(self) -> Array:
        """S, covariance of the innovation, shape (m, m)."""
        return self.projection.schur


class DualRecursion:
    """D and R of the measured rows, and their field.

    Memory is that of `LowRankKernel`, D and three vectors of V.

    Attributes:
        height: Rows per block [–].
        prior_field: p₀, the Laplace field, shape (V,).
    """

    def __init__(self, laplace: LaplaceSystem, b: Array, *, height: int) -> None:
        """Start without measurements: one solve for p₀, and compiling.

        Args:
            laplace: L.
            b: Right side of L p = b, shape (V,).
            height: Rows per block [–].
        """
        self.height = height
        self._prior = LaplacePrior(laplace, np.ones(laplace.grid.n_voxels))
        self._D = MeasuredRows(laplace.grid.n_voxels, height)
        self._begin_factor()
        # above `DEPENDENT` where weights are too large for the solves
        self._tolerance = DEPENDENT
        # whether R must be recomputed from D
        self._stale = False
        self._d0 = np.zeros(0)
        # p - p₀ and its y; None when it must be recomputed
        self._shift: Array | None = None
        self._y = np.zeros(0)
        self.prior_field = laplace.solve(b)
        _warm_up(height)

    def __len__(self) -> int:
        """Number of blocks held [–]."""
        return len(self._D)

    @property
    def memory_bytes(self) -> int:
        """Memory that grows with the measurements."""
        rows = self._D.memory_bytes + self._basis.memory_bytes
        return self._kernel.memory_bytes + rows + 2 * self._d0.nbytes

    @property
    def n_rows(self) -> int:
        """Number of rows held n [–]."""
        return len(self._d0)

    @property
    def misfit(self) -> float:
        """d₀ᵀ(I + K)⁻¹d₀ [–].

        The sum of the squares of all normalised innovations, and the minimum of the
        objective.
        """
        self._ensure_factor()
        return float(self._d0 @ self._kernel.solve(self._d0))

    def forecast(self, block: Block) -> Forecast:
        """Predict new rows from the rows held.

        Costs two solves with A per row, in parallel, and O(k²) with k the rank.

        Args:
            block: The new rows.

        Raises:
            NumericalError: Weights so large that rounding errors dominate.
        """
        self._ensure_factor()
        projection, columns = self._projected(block)
        if _least(projection) < LEAST_SCHUR:
            self._rebuild()
            projection, columns = self._projected(block)
        if (least := _least(projection)) < LEAST_SCHUR:
            raise NumericalError(
                f"the innovation's covariance is {least:.2g} of the noise, expected "
                "at least 1: the weights are too large for the accuracy of the "
                "solves, lower them"
            )
        prior = self.prior_field[block.voxels] @ block.values
        mean = prior + self._d0 @ self._kernel.R @ projection.gain
        return Forecast(block, projection, columns, prior, mean)

    def append(self, forecast: Forecast, target: Array) -> None:
        """Add the rows of a forecast.

        Args:
            forecast: Made by `forecast` since the last change.
            target: Measurements, weighted as the rows, shape (m,).
        """
        self._take(forecast.block, forecast.projection, forecast.columns)
        self._D.append(forecast.block)
        self._d0 = np.concatenate([self._d0, target - forecast.prior])
        # the last field belongs to y = 0 in the new rows
        self._y = np.concatenate([self._y, np.zeros(len(target))])

    def remove(self, start: int, count: int) -> None:
        """Remove blocks start to start + count.

        Costs as `LowRankKernel.remove`; from time to time R's basis settles, with a
        pair of solves at most for each of its rows that were removed since.
        """
        held = len(self)
        if count == 0:
            return
        rows = slice(self.height * start, self.height * (start + count))
        self._D.keep(np.delete(np.arange(held), slice(start, start + count)))
        self._d0 = np.delete(self._d0, rows)
        if not self._stale:
            self._kernel.remove(rows.start, self.height * count)
            if self._kernel.is_worn:
                self._settle()
        self._reset_field()

    def fade(self, factor: float) -> None:
        """Multiply the weight of every row held; O(n k²).

        Args:
            factor: In (0, 1] [–].

        Raises:
            InputError: factor is outside this range.
        """
        if not 0.0 < factor <= 1.0:
            raise InputError(f"a fading factor must lie in (0, 1], got {factor}")
        root = float(np.sqrt(factor))
        if not self._stale:
            self._kernel.scale(root)
        self._D.scale(root)
        self._d0 = self._d0 * root
        self._reset_field()

    def field(self) -> Array:
        """The field p, shape (V,), from (I + K) y = d₀ by conjugate gradients.

        Costs two solves with A and O(n k) per round; nothing if nothing has changed.

        Raises:
            NumericalError: `FIELD_RTOL` was not reached.
        """
        self._ensure_factor()
        left = self._refined()
        if left > FIELD_RTOL:
            self._rebuild()
            left = self._refined()
        if self._shift is None or left > FIELD_RTOL:
            self._reset_field()
            raise NumericalError(
                f"the field's dual residual stays at {left:.1e} after {FIELD_ROUNDS} "
                f"rounds, {FIELD_RTOL:.0e} was requested: the weights are too large "
                "for the accuracy of the solves, lower them"
            )
        return self.prior_field + self._shift

    def _refined(self) -> float:
        """Refine the last field for `FIELD_ROUNDS` rounds at most.

        K is not formed: a round takes a solve with Lᵀ and one with L. The conjugate
        gradients are flexible because the solves are inexact: Notay, SIAM J. Sci.
        Comput. 22 (2000) 1444-1460.

        Returns:
            ‖d₀ - D (p - p₀) - y‖ over ‖d₀‖, 0 if at most `FIELD_RTOL` [–].
        """
        shift, y, d0 = self._shift, self._y, self._d0
        if shift is None:
            shift, y = np.zeros_like(self.prior_field), np.zeros_like(d0)
        size = float(np.linalg.norm(d0))
        direction, before, fall = np.zeros_like(d0), np.zeros_like(d0), 1.0
        left = np.inf
        for rounds in range(FIELD_ROUNDS + 1):
            residual = d0 - self._D.times(shift) - y
            left = float(np.linalg.norm(residual))
            if left <= FIELD_RTOL * size or rounds == FIELD_ROUNDS:
                break
            step = self._kernel.solve(residual)
            direction = step + (step @ (residual - before) / fall) * direction
            before, fall = residual, float(step @ residual)
            # a small correction needs less accuracy
            rtol = min(max(self._prior.rtol, 0.1 * FIELD_RTOL * size / left), 1e-4)
            response = self._prior.within(rtol).times(self._D.adjoint(direction))
            length = direction @ (direction + self._D.times(response))
            if not (fall > 0.0 and length > 0.0):
                break
            part = float(direction @ residual / length)
            shift, y = shift + part * response, y + part * direction
        self._shift, self._y = shift, y
        return 0.0 if left <= FIELD_RTOL * size else left / size

    def _projected(self, block: Block) -> tuple[Projection, Array]:
        """Project a block on R; also the entries of K for its new columns."""
        kernel, m = self._kernel, self.height
        rtol = self._accuracy(np.sum(block.values**2, axis=0))
        held, own = np.empty((m, kernel.rank)), np.empty((m, m))
        columns = np.zeros((m, len(kernel)))

        def compare(c: int, x: Array) -> None:
            held[c] = kernel.coordinates(self._basis.times(x)[None])[0]
            own[c] = x[block.voxels] @ block.values
            if own[c, c] - held[c] @ held[c] > 0.5 * self._tolerance:
                columns[c] = self._D.times(x)[: len(kernel)]

        self._apply_inverse(
            [(block.voxels, row) for row in block.values.T], rtol, compare
        )
        projection = kernel.project(held, 0.5 * (own + own.T), self._tolerance)
        return projection, columns[projection.chosen]

    def _take(self, block: Block, projection: Projection, columns: Array) -> None:
        """Add the projected rows of a block to R, and to its basis."""
        self._kernel.append(projection, columns)
        for row in block.values.T[projection.chosen]:
            self._basis.append(Block(block.voxels, row[:, None]))

    def _settle(self) -> None:
        """Replace what is in R's basis and no more in D."""
        kernel = self._kernel
        self._basis.keep(np.flatnonzero(kernel.basis >= 0))
        rows = kernel.settle(self._tolerance)
        if not len(rows):
            return
        entries = [self._D.row(int(i)) for i in rows]
        rtol = self._accuracy(np.array([values @ values for _, values in entries]))
        columns = np.empty((len(rows), len(kernel)))

        def compare(c: int, x: Array) -> None:
            columns[c] = self._D.times(x)

        try:
            self._apply_inverse(entries, rtol, compare)
        except NumericalError:
            # reported when R is needed next
            self._stale = True
            return
        held, own = kernel.coordinates(columns[:, kernel.basis]), columns[:, rows]
        projection = kernel.project(held, 0.5 * (own + own.T), self._tolerance)
        chosen = projection.chosen
        kernel.extend(projection, columns[chosen], rows[chosen])
        for voxels, row in (entries[c] for c in chosen):
            self._basis.append(Block(voxels, row[:, None]))

    def _begin_factor(self) -> None:
        self._kernel = LowRankKernel()
        self._basis = MeasuredRows(self._D.n_voxels, 1)

    def _ensure_factor(self) -> None:
        """Recompute R if it is unusable."""
        if self._stale:
            self._rebuild()

    def _rebuild(self) -> None:
        """Recompute R from D, with as many solves as for adding all blocks."""
        self._stale = True
        self._begin_factor()
        for s in range(len(self)):
            block = self._D.block(s)
            self._take(block, *self._projected(block))
        self._stale = False
        self._reset_field()

    def _accuracy(self, sizes: Array) -> float:
        """Relative residual of solves for columns of K of rows with these ‖h‖²."""
        largest = max(float(sizes.max(initial=0.0)), 1e-300)
        rtol = min(max(self._prior.rtol, DEPENDENT / (MARGIN * largest)), COLUMN_RTOL)
        self._tolerance = max(self._tolerance, MARGIN * rtol * largest)
        return rtol

    def _apply_inverse(
        self,
        entries: Sequence[tuple[NDArray[np.int32], Array]],
        rtol: float,
        take: Callable[[int, Array], None],
    ) -> None:
        """Compute L⁻¹L⁻ᵀhᵀ of rows in parallel and pass each on.

        Args:
            entries: Voxels and values of the rows h.
            rtol: Relative residual of the solves.
            take: Called with a row's number and vector, from several threads.
        """
        prior = self._prior.within(rtol)

        def chain(c: int) -> None:
            row = np.zeros(len(self.prior_field))
            row[entries[c][0]] = entries[c][1]
            take(c, prior.times(row))

        side_by_side(chain, range(len(entries)))

    def _reset_field(self) -> None:
        """Start from p₀ again after rows were removed or changed, or a failure."""
        self._shift, self._y = None, np.zeros(len(self._d0))


def _warm_up(height: int) -> None:
    """Compile ahead of the first update."""
    update(np.ones((1, 1)), np.zeros((1, height)))
    rows = MeasuredRows(1, height)
    rows.append(Block(np.zeros(1, dtype=np.int32), np.zeros((1, height))))
    rows.adjoint(rows.times(np.zeros(1)))


def _least(projection: Projection) -> float:
    """Smallest eigenvalue of the innovation's covariance."""
    return float(np.linalg.eigvalsh(projection.schur)[0])
