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
from typing import Self

import numpy as np
import scipy.optimize

from ttus_opt.arrays import Array
from ttus_opt.fitting.marginal_likelihood import MeasuredSeries, SeriesNoise

#: Least share of a most likely weight that a fit uses [–]
LEAST_SHARE = 1e-4

#: Accuracy of the logarithm of a share, of the error, and most evaluations
ACCURACY, RELATIVE_ACCURACY, MOST = 0.05, 1e-4, 80

#: Share at which the search starts, and its first step, a factor
START, STEP = 0.1, 4.0

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
        total, one = 0.0, np.eye(self.gram.shape[-1])
        whole, spread = self.gram.sum(axis=0), self.cross.sum(axis=0)
        for gram, inner, cross in zip(self.gram, self.inner, self.cross, strict=True):
            rest = spread - cross - cross.transpose(0, 2, 1) + inner
            M = one + np.tensordot(shares, whole - gram, axes=1)
            S = one + np.tensordot(shares**2, rest, axes=1)
            inverse = np.linalg.inv(M)
            mean = inverse @ S @ inverse
            shared = np.tensordot(shares, cross - inner, axes=1)
            total += float((gram.sum(axis=0) * mean).sum())
            total -= 2.0 * float((shared * inverse).sum())
        return total

    def shares(self) -> Array:
        """Shares of the weights that err least, by term, shape (terms,) [–].

        All 1 with a single place, which nothing predicts.
        """
        n = self.gram.shape[1]
        if len(self.gram) < 2:
            return np.ones(n)

        def shares(steps: Array) -> Array:
            return np.asarray(np.exp(np.clip(steps, np.log(LEAST_SHARE), 0.0)))

        def cost(steps: Array) -> float:
            return self.error(shares(steps))

        start = np.full(n, np.log(START))
        found = scipy.optimize.minimize(
            cost,
            start,
            method="Nelder-Mead",
            options={
                "initial_simplex": np.vstack([start, start + np.log(STEP) * np.eye(n)]),
                "xatol": ACCURACY,
                "fatol": RELATIVE_ACCURACY * abs(cost(start)),
                "maxfev": MOST,
            },
        )
        return shares(found.x)


def _times(correlation: Array, values: Array) -> Array:
    """Frames mixed, (n, n) times (n, k, 3)."""
    return np.asarray(
        (correlation @ values.reshape(len(values), -1)).reshape(values.shape)
    )


def _flat(values: Array) -> Array:
    """Rows of images: (frames, k, 3) to (k, rows)."""
    return np.asarray(np.moveaxis(values, 1, 0).reshape(values.shape[1], -1))
