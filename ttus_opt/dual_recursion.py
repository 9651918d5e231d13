"""The dual system of eq. 10 as it grows and shrinks (design §3, structures d and e).

With D the weighted measured rows, t their targets, p₀ = L⁻¹b and K = D L⁻¹L⁻ᵀDᵀ, the
minimiser of ‖L p - b‖² + ‖D p - t‖² is

    p = p₀ + L⁻¹L⁻ᵀDᵀ y,    (I + K) y = d₀,    d₀ = t - D p₀.

A measurement adds rows h to D: their columns of K are D L⁻¹L⁻ᵀhᵀ, one solve with Lᵀ
and one with L per row. This is the Sherman-Morrison-Woodbury recursion, with the dense
V × rows matrix L⁻¹L⁻ᵀDᵀ left out: what is kept is D (sparse) and R with K ≈ R Rᵀ, of
as many columns as rows say something new (`ttus_opt.low_rank_kernel`); only with the
rows that brought a column must a new one be compared.

Read statistically, with p ~ Normal(p₀, (LᵀL)⁻¹) and noise of variance 1 on every
weighted row, the same quantities predict a measurement before it is folded in: with r
its part in R's columns, its innovation has the covariance

    S = I + h L⁻¹L⁻ᵀhᵀ - r rᵀ + r M⁻¹rᵀ,    M = I + RᵀR,

and its mean is that of the field at hand and, for rows since, r M⁻¹Rᵀ times what the
field at hand leaves of them.

The columns of K need not be solved for to the last digit, and R need not be all of K:
I + R Rᵀ preconditions, and the field is refined until (I + K) y = d₀ holds to
`FIELD_RTOL` with solves of full accuracy.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.errors import InputError, NumericalError
from ttus_opt.laplace import RTOL, LaplaceSystem
from ttus_opt.low_rank_kernel import LowRankKernel, Outlook
from ttus_opt.measured_rows import Block, MeasuredRows

Array = NDArray[np.float64]

#: Relative residual of (I + K) y = d₀ to which the field is refined, and most rounds
FIELD_RTOL, FIELD_ROUNDS = 1e-9, 12

#: Variance of a row, in units of its noise, that is none beyond what others span
SPAN = 1e-6

#: Largest relative residual of the solves behind the columns of K, and by how much
#: their error, about this times ‖h‖², must lie below `SPAN`: it is no column, either
COLUMN_RTOL, MARGIN = 1e-7, 100.0

#: Schur complements are at least one; below this, rounding has taken over
LEAST_SCHUR = 0.9


@dataclass(frozen=True)
class Forecast:
    """A block of new rows, seen from what is held; m rows beside n held ones.

    Attributes:
        block: The rows h.
        outlook: The rows in R's columns.
        prior: h p₀, shape (m,).
        known: h p of the field at hand, shape (m,).
        mean: Predicted measurement, shape (m,).
    """

    block: Block
    outlook: Outlook
    prior: Array
    known: Array
    mean: Array

    @property
    def schur(self) -> Array:
        """S, covariance of the innovation, shape (m, m)."""
        return self.outlook.schur


class DualRecursion:
    """D and R of the measured rows so far, and the field they make.

    Memory is that of `LowRankKernel` and D beside three vectors of V.

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
        self._laplace = laplace
        self._D = MeasuredRows(laplace.grid.n_voxels, height)
        self._kernel = LowRankKernel()
        # grows beyond `SPAN` where weights are too large for the solves
        self._tolerance = SPAN
        self._d0 = np.zeros(0)
        # Rᵀ(d₀ - D(p - p₀) - y), p the field at hand
        self._information = np.zeros(0)
        # p - p₀ and the y it belongs to; None when it must be made anew
        self._shift: Array | None = None
        self._y = np.zeros(0)
        self.prior_field = laplace.solve(b)
        _warm_up(height)

    def __len__(self) -> int:
        """Number of blocks held [–]."""
        return len(self._D)

    @property
    def memory_bytes(self) -> int:
        """Size of what grows with the measurements."""
        vectors = self._d0.nbytes + self._information.nbytes + self._y.nbytes
        return self._kernel.memory_bytes + self._D.memory_bytes + vectors

    @property
    def n_rows(self) -> int:
        """Number of rows held n [–]."""
        return len(self._d0)

    @property
    def rank(self) -> int:
        """Number of rows that said something new, columns of R [–]."""
        return self._kernel.rank

    @property
    def misfit(self) -> float:
        """d₀ᵀ(I + K)⁻¹d₀ [–].

        The sum of the squares of all innovations by their predicted spread, and the
        least value of the objective.
        """
        return float(self._d0 @ self._kernel.solve(self._d0))

    def forecast(self, block: Block) -> Forecast:
        """Predict new rows from all that is held.

        Costs two solves with A per row, rows side by side on all cores, and O(k²) with
        k the rank.

        Args:
            block: The new rows.

        Raises:
            NumericalError: Weights so large that rounding takes over.
        """
        sizes = np.sum(block.values**2, axis=0)
        largest = max(float(sizes.max(initial=0.0)), 1e-300)
        rtol = min(max(RTOL, SPAN / (MARGIN * largest)), COLUMN_RTOL)
        self._tolerance = max(self._tolerance, MARGIN * rtol * largest)
        cross, own = self._columns(block, rtol)
        outlook = self._kernel.outlook(cross, own, self._tolerance)
        least = float(np.linalg.eigvalsh(outlook.schur)[0])
        if least < LEAST_SCHUR:
            raise NumericalError(
                f"the innovation's covariance is {least:.2g} of the noise where it is "
                "at least 1: the weights are too large for the solves, lower them"
            )
        prior = self.prior_field[block.voxels] @ block.values
        known = prior
        if self._shift is not None:
            known = prior + self._shift[block.voxels] @ block.values
        return Forecast(
            block, outlook, prior, known, known + self._information @ outlook.gain
        )

    def append(self, forecast: Forecast, target: Array) -> None:
        """Take the rows of a forecast in.

        Args:
            forecast: Made by `forecast` since the last change.
            target: What was measured, weighted as the rows, shape (m,).
        """
        self._kernel.append(forecast.outlook)
        self._D.append(forecast.block)
        self._d0 = np.concatenate([self._d0, target - forecast.prior])
        information = (target - forecast.known) @ forecast.outlook.rows
        information[: len(self._information)] += self._information
        self._information = information
        # y = 0 for the new rows is what the field at hand belongs to
        self._y = np.concatenate([self._y, np.zeros(len(target))])

    def remove(self, start: int, count: int) -> None:
        """Take blocks start to start + count out; costs as `LowRankKernel.remove`.

        Raises:
            InputError: Blocks that are not there.
        """
        held = len(self)
        if start < 0 or count < 0 or start + count > held:
            raise InputError(
                f"blocks {start} to {start + count} are not within 0 to {held}"
            )
        if count == 0:
            return
        rows = slice(self.height * start, self.height * (start + count))
        self._D.keep(np.delete(np.arange(held), slice(start, start + count)))
        self._d0 = np.delete(self._d0, rows)
        self._kernel.remove(rows.start, rows.stop - rows.start, self._tolerance)
        self._restart()

    def fade(self, factor: float) -> None:
        """Multiply the weight of every row held; O(n k²).

        Args:
            factor: In (0, 1] [–].

        Raises:
            InputError: factor is not within these.
        """
        if not 0.0 < factor <= 1.0:
            raise InputError(f"a fading factor must lie in (0, 1], got {factor}")
        root = float(np.sqrt(factor))
        self._kernel.scale(root)
        self._D.scale(root)
        self._d0 = self._d0 * root
        self._restart()

    def field(self) -> Array:
        """Solve (I + K) y = d₀ with R for K, and make p, shape (V,).

        Nothing if nothing changed, else per round two solves with A and O(n k).

        Raises:
            NumericalError: `FIELD_RTOL` was not reached.
        """
        laplace = self._laplace
        if self._shift is None:
            self._shift = np.zeros(laplace.grid.n_voxels)
            self._y = np.zeros_like(self._d0)
        size = float(np.linalg.norm(self._d0))
        for _ in range(FIELD_ROUNDS):
            residual = self._d0 - self._D.times(self._shift) - self._y
            now = float(np.linalg.norm(residual))
            if now <= FIELD_RTOL * size:
                self._information = np.zeros(self._kernel.rank)
                return self.prior_field + self._shift
            step = self._kernel.solve(residual)
            # a small correction need not be known to as many digits
            rtol = min(max(RTOL, 0.1 * FIELD_RTOL * size / now), 1e-4)
            source = laplace.solve_adjoint(self._D.adjoint(step), rtol=rtol)
            self._shift = self._shift + laplace.solve(source, rtol=rtol)
            self._y = self._y + step
        self._restart()
        raise NumericalError(
            f"the field's dual residual stays at {now / size:.1e} after {FIELD_ROUNDS} "
            f"rounds, {FIELD_RTOL:.0e} was asked for: the weights are too large for "
            "the solves, lower them"
        )

    def _columns(self, block: Block, rtol: float) -> tuple[Array, Array]:
        """Rows of D at the pivots times L⁻¹L⁻ᵀhᵀ, transposed (m, k), and h's (m, m)."""
        laplace, m, pivots = self._laplace, self.height, self._kernel.pivots
        cross, own = np.empty((m, len(pivots))), np.empty((m, m))

        def chain(c: int) -> None:
            row = np.zeros(laplace.grid.n_voxels)
            row[block.voxels] = block.values[:, c]
            x = laplace.solve(laplace.solve_adjoint(row, rtol=rtol), rtol=rtol)
            cross[c] = self._D.times(x, pivots)
            own[c] = x[block.voxels] @ block.values

        with ThreadPoolExecutor(min(m, len(os.sched_getaffinity(0)))) as pool:
            list(pool.map(chain, range(m)))
        return cross, 0.5 * (own + own.T)

    def _restart(self) -> None:
        """Start anew from p₀: rows went or changed, or the field failed."""
        self._information = self._kernel.adjoint(self._d0)
        self._shift, self._y = None, np.zeros(len(self._d0))


def _warm_up(height: int) -> None:
    """Compile, so that no update has to."""
    kernel = LowRankKernel()
    none = np.zeros((height, 0))
    kernel.append(kernel.outlook(none, np.eye(height), 0.0))
    kernel.solve(np.zeros(height))
    kernel.remove(0, 1, 0.0)
    rows = MeasuredRows(1, height)
    rows.append(Block(np.zeros(1, dtype=np.int32), np.zeros((1, height))))
    rows.adjoint(rows.times(np.zeros(1)))
    rows.times(np.zeros(1), kernel.pivots)
