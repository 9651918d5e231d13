"""The dual system of eq. 10 as it grows and shrinks (design §3, structures d and e).

With D the weighted measured rows, t their targets, p₀ = L⁻¹b and K = D L⁻¹L⁻ᵀDᵀ, the
minimiser of ‖L p - b‖² + ‖D p - t‖² is

    p = p₀ + L⁻¹L⁻ᵀDᵀ y,    (I + K) y = d₀,    d₀ = t - D p₀.

A measurement adds rows h to D: their columns of K are D L⁻¹L⁻ᵀhᵀ, one solve with Lᵀ
and one with L per row, and a Cholesky factor F of I + K grows by as many rows. This
is the Sherman-Morrison-Woodbury recursion, with the dense V × rows matrix L⁻¹L⁻ᵀDᵀ
left out: what is kept is D (sparse), F and z = F⁻¹d₀.

Read statistically, with p ~ Normal(p₀, (LᵀL)⁻¹) and noise of variance 1 on every
weighted row, the same quantities predict a measurement before it is folded in: its
mean is h p₀ + xᵀz with x = F⁻¹D L⁻¹L⁻ᵀhᵀ, and its innovation has the covariance
S = I + h L⁻¹L⁻ᵀhᵀ - xᵀx, the Schur complement by which F grows.

The columns of K need not be solved for to the last digit: F preconditions, and the
field is refined until (I + K) y = d₀ holds to `FIELD_RTOL` with solves of full
accuracy.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.errors import InputError, NumericalError
from ttus_opt.growing_factor import GrowingFactor
from ttus_opt.laplace import RTOL, LaplaceSystem
from ttus_opt.measured_rows import Block, MeasuredRows

Array = NDArray[np.float64]

#: Relative residual of (I + K) y = d₀ to which the field is refined, and most rounds
FIELD_RTOL, FIELD_ROUNDS = 1e-11, 12

#: Largest relative residual of the solves behind the columns of K, and the error of
#: I + K, whose eigenvalues are at least one, that all of them together may make
COLUMN_RTOL, FACTOR_ERROR = 1e-6, 1e-2

#: Schur complements are at least one; below this, rounding has taken over
LEAST_SCHUR = 0.9


@dataclass(frozen=True)
class Forecast:
    """A block of new rows, seen from what is held; m rows beside n held ones.

    Attributes:
        block: The rows h.
        reduced: x = F⁻¹D L⁻¹L⁻ᵀhᵀ, transposed, shape (m, n).
        schur: S, covariance of the innovation, shape (m, m).
        prior: h p₀, shape (m,).
        mean: Predicted measurement, shape (m,).
    """

    block: Block
    reduced: Array
    schur: Array
    prior: Array
    mean: Array


class DualRecursion:
    """D, F and z of the measured rows so far, and the field they make.

    Memory is that of F (`GrowingFactor`) and D beside three vectors of V.

    Attributes:
        height: Rows per block [–].
        capacity: Most blocks that are expected [–].
        prior_field: p₀, the Laplace field, shape (V,).
    """

    def __init__(
        self, laplace: LaplaceSystem, b: Array, *, height: int, capacity: int
    ) -> None:
        """Start without measurements: one solve for p₀, and compiling.

        Args:
            laplace: L.
            b: Right side of L p = b, shape (V,).
            height: Rows per block [–].
            capacity: Most blocks that are expected; sets how well a column of K must
                be known [–].
        """
        self.height = height
        self.capacity = capacity
        self._laplace = laplace
        self._column_rtol = COLUMN_RTOL
        self._D = MeasuredRows(laplace.grid.n_voxels, height)
        self._factor = GrowingFactor()
        self._d0 = np.zeros(0)
        self._z = np.zeros(0)
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
        vectors = self._d0.nbytes + self._z.nbytes + self._y.nbytes
        return self._factor.memory_bytes + self._D.memory_bytes + vectors

    @property
    def whitened(self) -> Array:
        """z: innovations by their predicted spread, uncorrelated, shape (n,)."""
        return self._z

    def forecast(self, block: Block) -> Forecast:
        """Predict new rows from all that is held.

        Costs two solves with A per row, rows side by side on all cores, and O(n²).

        Args:
            block: The new rows.

        Raises:
            NumericalError: Weights so large that rounding takes over.
        """
        rtol = self._column_rtol
        cross, own = self._columns(block, rtol)
        # all columns of a full fit together must not spoil I + K
        needed = FACTOR_ERROR / (self.capacity * max(float(np.trace(own)), 1e-300))
        if needed < rtol:
            self._column_rtol = rtol = max(needed, RTOL)
            cross, own = self._columns(block, rtol)
        reduced, schur = self._reduce(cross, own)
        if np.linalg.eigvalsh(schur)[0] < LEAST_SCHUR and rtol > RTOL:
            self._column_rtol = RTOL
            reduced, schur = self._reduce(*self._columns(block, RTOL))
        least = float(np.linalg.eigvalsh(schur)[0])
        if least < LEAST_SCHUR:
            raise NumericalError(
                f"the innovation's covariance is {least:.2g} of the noise where it is "
                "at least 1: the weights are too large for the solves, lower them"
            )
        prior = block.values.T @ self.prior_field[block.voxels]
        return Forecast(block, reduced, schur, prior, prior + reduced @ self._z)

    def append(self, forecast: Forecast, target: Array) -> None:
        """Take the rows of a forecast in.

        Args:
            forecast: Made by `forecast` since the last change.
            target: What was measured, weighted as the rows, shape (m,).
        """
        self._factor.append(forecast.reduced, forecast.schur)
        root = np.linalg.cholesky(forecast.schur)
        new = np.linalg.solve(root, target - forecast.mean)
        self._D.append(forecast.block)
        self._d0 = np.concatenate([self._d0, target - forecast.prior])
        self._z = np.concatenate([self._z, new])
        # y = 0 for the new rows is what the field at hand belongs to
        self._y = np.concatenate([self._y, np.zeros(len(new))])

    def remove(self, start: int, count: int) -> None:
        """Take blocks start to start + count out; cheap for the last ones.

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
        self._factor.remove(rows.start, rows.stop - rows.start)
        self._D.keep(np.delete(np.arange(held), slice(start, start + count)))
        self._d0 = np.delete(self._d0, rows)
        if start + count == held:
            self._restart(self._z[: rows.start])
        else:
            self._restart(self._factor.forward(self._d0[None])[0])

    def fade(self, factor: float) -> None:
        """Multiply the weight of every row held; O(n³).

        Args:
            factor: In (0, 1] [–].

        Raises:
            InputError: factor is not within these.
        """
        if not 0.0 < factor <= 1.0:
            raise InputError(f"a fading factor must lie in (0, 1], got {factor}")
        root = float(np.sqrt(factor))
        self._factor = self._factor.faded(factor)
        self._D.scale(root)
        self._d0 = self._d0 * root
        self._restart(self._factor.forward(self._d0[None])[0])

    def field(self) -> Array:
        """Solve (I + K) y = d₀ with F for I + K, and make p, shape (V,).

        Nothing if nothing changed, else per round two solves with A and O(n²).

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
                return self.prior_field + self._shift
            step = self._factor.backward(self._factor.forward(residual[None])[0])
            # a small correction need not be known to as many digits
            rtol = min(max(RTOL, 0.1 * FIELD_RTOL * size / now), 1e-4)
            source = laplace.solve_adjoint(self._D.adjoint(step), rtol=rtol)
            self._shift = self._shift + laplace.solve(source, rtol=rtol)
            self._y = self._y + step
        self._shift = None
        raise NumericalError(
            f"the field's dual residual stays at {now / size:.1e} after {FIELD_ROUNDS} "
            f"rounds, {FIELD_RTOL:.0e} was asked for: the weights are too large for "
            "the solves, lower them"
        )

    def _columns(self, block: Block, rtol: float) -> tuple[Array, Array]:
        """D L⁻¹L⁻ᵀhᵀ, transposed (m, n), and h L⁻¹L⁻ᵀhᵀ (m, m)."""
        laplace, m = self._laplace, self.height
        cross, own = np.empty((m, len(self._d0))), np.empty((m, m))

        def chain(c: int) -> None:
            row = np.zeros(laplace.grid.n_voxels)
            row[block.voxels] = block.values[:, c]
            x = laplace.solve(laplace.solve_adjoint(row, rtol=rtol), rtol=rtol)
            cross[c] = self._D.times(x)
            own[c] = x[block.voxels] @ block.values

        with ThreadPoolExecutor(min(m, len(os.sched_getaffinity(0)))) as pool:
            list(pool.map(chain, range(m)))
        return cross, 0.5 * (own + own.T)

    def _reduce(self, cross: Array, own: Array) -> tuple[Array, Array]:
        """Make x and S of the new rows."""
        reduced = self._factor.forward(cross)
        # einsum: too little work to wake a threaded BLAS for
        return reduced, np.eye(len(own)) + own - np.einsum("in,jn", reduced, reduced)

    def _restart(self, z: Array) -> None:
        """Note z after rows have gone or changed; the field is made anew."""
        self._z = z
        self._shift, self._y = None, np.zeros(len(self._d0))


def _warm_up(height: int) -> None:
    """Compile, so that no update has to."""
    factor = GrowingFactor()
    factor.append(np.zeros((height, 0)), np.eye(height))
    factor.backward(factor.forward(np.zeros((1, height)))[0])
    factor.remove(0, 1)
    rows = MeasuredRows(1, height)
    rows.append(Block(np.zeros(1, dtype=np.int32), np.zeros((1, height))))
    rows.adjoint(rows.times(np.zeros(1)))
