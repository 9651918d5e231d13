"""Errors of measured rows that are correlated along a press.

The error of a row is sensor noise, new in every frame, plus what the model cannot
represent, which changes slowly along a press: an Ornstein-Uhlenbeck process of
correlation time T, independent between presses. With w the variance of the former over
that of the latter, the correlation over the frames is

    R(i, j) = (exp(-|tᵢ - tⱼ|/T) + w δᵢⱼ)/(1 + w)    in one press, otherwise 0:

one block per press, which is factorised by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg

from ttus_opt.arrays import Array, IntArray


@dataclass(frozen=True)
class PressTimes:
    """The frames of one press.

    Attributes:
        frames: Which frames of the series.
        apart: Time between any two of them, shape (n, n) [s].
    """

    frames: slice
    apart: Array = field(repr=False)

    @classmethod
    def of(cls, time: Array, press: IntArray) -> list[PressTimes]:
        """All presses of a series.

        Args:
            time: Of the frames [s].
            press: Press of every frame; frames of one press are consecutive [–].
        """
        ends = [*(np.flatnonzero(np.diff(press)) + 1).tolist(), len(press)]
        frames = [slice(a, b) for a, b in zip([0, *ends], ends, strict=False) if a < b]
        return [cls(at, np.abs(time[at, None] - time[at])) for at in frames]


@dataclass(frozen=True)
class Whitening:
    """What makes the errors of one press independent and of equal variance.

    Attributes:
        frames: Which frames of the series.
        filter: A with Aᵀ A = R⁻¹, lower triangular, shape (n, n) [–].
        by_sensor: Derivative of R by w, shape (n, n) [–].
        by_time: Derivative of R by T, shape (n, n) [1/s].
    """

    frames: slice
    filter: Array = field(repr=False)
    by_sensor: Array = field(repr=False)
    by_time: Array = field(repr=False)


@dataclass(frozen=True)
class SeriesNoise:
    """Correlation of the errors of measured rows.

    Attributes:
        correlation_time: T of the part that changes slowly; 0 for none [s].
        sensor: w, variance of sensor noise over that part's, shape (terms,) [–].
    """

    correlation_time: float
    sensor: Array

    def correlation(self, time: Array, press: IntArray, term: int) -> Array:
        """R of one term's errors, shape (frames, frames).

        Args:
            time: Of the frames [s].
            press: Press of every frame [–].
            term: Number of the term [–].
        """
        slow = self._slow(np.abs(time[:, None] - time))
        slow = np.where(press[:, None] == press, slow, 0.0)
        own = float(self.sensor[term])
        slow[np.diag_indices_from(slow)] = 1.0 + own
        return np.asarray(slow / (1.0 + own))

    def whitening(self, press: PressTimes) -> list[Whitening]:
        """What whitens the errors along one press, for every term."""
        slow, unit = self._slow(press.apart), np.eye(len(press.apart))
        with np.errstate(divide="ignore", invalid="ignore"):
            by_time = np.nan_to_num(slow * press.apart / self.correlation_time**2)
        found = []
        for own in self.sensor:
            R = (slow + own * unit) / (1.0 + own)
            inverse, _ = scipy.linalg.lapack.dtrtri(np.linalg.cholesky(R), lower=1)
            by_own = (unit - R) / (1.0 + own)
            found.append(
                Whitening(press.frames, inverse, by_own, by_time / (1.0 + own))
            )
        return found

    def _slow(self, apart: Array) -> Array:
        """exp(-|Δt|/T), with ones on the diagonal."""
        with np.errstate(divide="ignore", invalid="ignore"):
            slow = np.exp(-apart / self.correlation_time)
        slow[np.diag_indices_from(slow)] = 1.0
        return np.asarray(slow)
