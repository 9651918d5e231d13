"""Weights that predict the wrenches at a place left out best, in expectation.

A formulation assumes independent frames of equal accuracy, but errors are correlated
along a press (`marginal_likelihood`). Its best weights are therefore not those of the
likelihood. With the errors' covariance Σ known, the expected error of predicting one
place F from all others has a closed form. With B the images times the roots of the
most likely weights and V the shares of these that a fit uses, by row,

    M = 1 + Σ_G V B_G B_Gᵀ,    S = cov Σ_G V B_G e_G,    C = cov(Σ_G V B_G e_G, e_F),
    E‖error‖² = tr B_Fᵀ M⁻¹(1 + S)M⁻¹ B_F - 2 tr B_Fᵀ M⁻¹ C + const,

G over all other places. The sum over all places is minimised. A place is a run of
frames of one press within the probe's own size: contacts nearer than that overlap, and
the next examination meets the same skin about as near to fitted places as one place of
this examination is to the others. See docs/method.md, "Tuning".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np
import scipy.optimize

from ttus_opt.arrays import Array
from ttus_opt.fitting.marginal_likelihood import MeasuredSeries
from ttus_opt.fitting.series_noise import SeriesNoise

#: Least share of a most likely weight that a fit uses [–]
LEAST_SHARE = 1e-4

#: Slope by the logarithm of a share at which the search ends, and its last gain, both
#: over the error; most evaluations
ACCURACY, RELATIVE_ACCURACY, MOST = 1e-4, 1e-6, 80

#: Share at which the search starts
START = 0.1

#: Most frames; each of fewer stands for several, whose sensor noise is averaged
MOST_FRAMES = 1000


@dataclass(frozen=True)
class PlaceLeftOut:
    """Sums over the rows of every place, k images and n places.

    Attributes:
        gram: B_F B_Fᵀ by place and term, shape (n, terms, k, k).
        inner: B_F Σ_FF B_Fᵀ, likewise.
        cross: B_F Σ Bᵀ with the rows of all places, likewise.
    """

    gram: Array = field(repr=False)
    inner: Array = field(repr=False)
    cross: Array = field(repr=False)

    @classmethod
    def of(cls, series: MeasuredSeries, weights: Array, noise: SeriesNoise) -> Self:
        """Sums for the most likely weights and noise.

        Args:
            series: Rows without a coefficient.
            weights: λ by term, shape (terms,) [–].
            noise: Correlation of their errors.
        """
        every = -(-series.frames // MOST_FRAMES)
        series = series.thinned(every)
        _, place = np.unique(series.place, return_inverse=True)
        k, terms, n = len(series.images), len(series.terms), int(place.max()) + 1
        gram, inner, cross = (np.zeros((n, terms, k, k)) for _ in range(3))
        for t in range(terms):
            # one mean of several frames: their sensor noise over their number
            sensor = noise.sensor[t] / every
            correlation = noise.correlation(series.time, series.press, t)
            correlation *= every
            diagonal = np.diag_indices_from(correlation)
            correlation[diagonal] *= (1.0 + sensor) / (1.0 + noise.sensor[t])
            B = np.sqrt(weights[t]) * np.moveaxis(series.images[:, t], 1, 0)
            spread = _times(correlation, B)
            for f in range(n):
                at = np.flatnonzero(place == f)
                own = _flat(B[at])
                gram[f, t] = every * own @ own.T
                within = correlation[np.ix_(at, at)]
                inner[f, t] = every * own @ _flat(_times(within, B[at])).T
                cross[f, t] = every * own @ _flat(spread[at]).T
        return cls(gram, inner, cross)

    def error(self, shares: Array) -> float:
        """Expected squared error over all places, up to a constant [–].

        In units of the variance of the rows' errors.

        Args:
            shares: Of the weights, by term, shape (terms,) [–].
        """
        return self.with_slope(shares)[0]

    def with_slope(self, shares: Array) -> tuple[float, Array]:
        """The same and its derivatives by the shares, shape (terms,)."""
        error, slope = 0.0, np.zeros(len(shares))
        one = np.eye(self.gram.shape[-1])
        for own, rest, noise, shared in zip(*self._of_others, strict=True):
            inverse = np.linalg.inv(one + np.tensordot(shares, rest, axes=1))
            S = one + np.tensordot(shares**2, noise, axes=1)
            C = np.tensordot(shares, shared, axes=1)
            half = inverse @ own
            mean, turned = half @ inverse, S @ half
            error += float((S * mean).sum() - 2.0 * (C * inverse).sum())
            # M changes as rest, and its inverse by -inverse rest inverse
            both = inverse @ (2.0 * C - turned - turned.T) @ inverse
            for t in range(len(shares)):
                slope[t] += 2.0 * shares[t] * float((noise[t] * mean).sum())
                slope[t] += float((rest[t] * both).sum())
                slope[t] -= 2.0 * float((shared[t] * inverse).sum())
        return error, slope

    @cached_property
    def _of_others(self) -> tuple[Array, Array, Array, Array]:
        """By place: own B Bᵀ, and by term those of M, of S and of C (symmetric)."""
        turned = np.swapaxes(self.cross, -1, -2)
        whole, spread = self.gram.sum(axis=0), self.cross.sum(axis=0)
        noise = spread - self.cross - turned + self.inner
        shared = 0.5 * (self.cross + turned) - self.inner
        return self.gram.sum(axis=1), whole - self.gram, noise, shared

    def shares(self) -> Array:
        """Shares of the weights that err least, by term, shape (terms,) [–].

        All 1 with a single place, which nothing predicts.
        """
        n = self.gram.shape[1]
        if len(self.gram) < 2:
            return np.ones(n)
        start = np.full(n, START)
        size = abs(self.error(start))

        def cost(logs: Array) -> tuple[float, Array]:
            shares = np.exp(logs)
            error, slope = self.with_slope(shares)
            return error / size, slope * shares / size

        found = scipy.optimize.minimize(
            cost,
            np.log(start),
            method="L-BFGS-B",
            jac=True,
            bounds=[(np.log(LEAST_SHARE), 0.0)] * n,
            options={"gtol": ACCURACY, "ftol": RELATIVE_ACCURACY, "maxfun": MOST},
        )
        return np.asarray(np.exp(found.x))


def _times(correlation: Array, values: Array) -> Array:
    """Frames mixed, (n, n) times (n, k, 3)."""
    return np.asarray(
        (correlation @ values.reshape(len(values), -1)).reshape(values.shape)
    )


def _flat(values: Array) -> Array:
    """Rows of images: (frames, k, 3) to (k, rows)."""
    return np.asarray(np.moveaxis(values, 1, 0).reshape(values.shape[1], -1))
