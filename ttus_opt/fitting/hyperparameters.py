"""Hyperparameters with weak priors, found by maximum a posteriori.

Data that say little of a hyperparameter would send it anywhere. Weak log-normal priors
keep each near a value that makes sense; where the data make it hardly more certain
than its prior, it keeps the prior's median and is named.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), section 5.4; the Hessian's use after D. J. C. MacKay, Neural Comput. 4 (1992).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize

from ttus_opt.arrays import Array

#: A hyperparameter is determined where its posterior standard deviation is below this
#: part of its prior's [–]
DETERMINED = 0.7

#: Step of the Hessian's differences, in prior standard deviations [–]
STEP = 0.2

#: Largest distance from the median, in prior standard deviations [–]
FARTHEST = 6.0

#: Accuracy of the search, in prior standard deviations and in the log density, and
#: most evaluations of it
ACCURACY, LOG_ACCURACY, MOST = 0.03, 0.05, 250


@dataclass(frozen=True)
class Prior:
    """A weak prior of one positive number.

    Attributes:
        name: Of the hyperparameter.
        median: Its prior value.
        spread: Standard deviation of its logarithm; of itself where it is linear [–].
        unit: Its unit.
        linear: Whether the prior is normal around the median and cut at 0, not
            log-normal.
        highest: Largest value.
    """

    name: str
    median: float
    spread: float
    unit: str = "1"
    linear: bool = False
    highest: float = math.inf

    def value(self, x: float) -> float:
        """The value x standard deviations from the median."""
        x = min(max(x, -FARTHEST), FARTHEST)
        if self.linear:
            return min(max(self.median + self.spread * x, 0.0), self.highest)
        return min(self.median * math.exp(self.spread * x), self.highest)

    def bounds(self, x: float) -> bool:
        """Whether a value that many standard deviations away is a bound."""
        return abs(x) >= FARTHEST or self.value(x) >= self.highest


@dataclass(frozen=True)
class Hyperparameter:
    """One that was looked for.

    Attributes:
        name: Its name.
        value: What is used.
        prior_value: The prior's median.
        spread: Posterior standard deviation of its logarithm, or of itself where the
            prior is linear; NaN where it was not determined [–].
        determined: Whether the data bear it; where not, the prior value is used.
        unit: Its unit.
        at_bound: Whether the value ended where none larger, or none smaller, is looked
            for; a coefficient of 0 is no bound but its absence.
    """

    name: str
    value: float
    prior_value: float
    spread: float
    determined: bool
    unit: str = "1"
    at_bound: bool = False


@dataclass(frozen=True)
class Maximum:
    """The likeliest hyperparameters.

    Attributes:
        found: In the order of the priors.
        log_posterior: Log density of data and hyperparameters there [–].
        log_marginal: The same with the hyperparameters integrated out around there,
            by Laplace's approximation: what models are compared by [–].
    """

    found: tuple[Hyperparameter, ...]
    log_posterior: float
    log_marginal: float


def maximise(log_density: Callable[[Array], float], priors: Sequence[Prior]) -> Maximum:
    """Find the likeliest values, and which of them the data bear.

    Args:
        log_density: Of the data, given values in the order of the priors.
        priors: At least one.
    """
    free = list(range(len(priors)))
    x = np.zeros(len(priors))
    while True:
        cost = _Cost(log_density, priors, free)
        x[free] = _minimum(cost, x[free])
        hessian = _hessian(cost, x[free])
        spread = _spreads(hessian)
        doubtful = [i for i, s in zip(free, spread, strict=True) if s > DETERMINED]
        if not doubtful:
            break
        worst = free[int(np.argmax(spread))]
        x[worst] = 0.0
        free.remove(worst)
        if not free:
            spread, hessian = np.zeros(0), np.zeros((0, 0))
            break
    spreads = dict(zip(free, spread, strict=True))
    found = tuple(
        Hyperparameter(
            prior.name,
            prior.value(float(x[i])),
            prior.median,
            float(spreads[i]) * prior.spread if i in spreads else math.nan,
            i in spreads,
            prior.unit,
            i in spreads and prior.bounds(float(x[i])),
        )
        for i, prior in enumerate(priors)
    )
    peak = -_Cost(log_density, priors, free)(x[free])
    occam = 0.0 if not free else -0.5 * float(np.linalg.slogdet(hessian)[1])
    return Maximum(found, peak, peak + occam)


class _Cost:
    """Minus the log posterior of some of the hyperparameters, the others at 0."""

    def __init__(
        self,
        log_density: Callable[[Array], float],
        priors: Sequence[Prior],
        free: Sequence[int],
    ) -> None:
        self._log_density, self._priors, self._free = log_density, priors, list(free)

    def __call__(self, x: Array) -> float:
        steps = np.zeros(len(self._priors))
        steps[self._free] = x
        values = [p.value(float(s)) for p, s in zip(self._priors, steps, strict=True)]
        return float(0.5 * x @ x - self._log_density(np.array(values)))


def _minimum(cost: _Cost, start: Array) -> Array:
    if not len(start):
        return start
    found = scipy.optimize.minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": np.vstack([start, start + np.eye(len(start))]),
            "xatol": ACCURACY,
            "fatol": LOG_ACCURACY,
            "maxfev": MOST,
        },
    )
    return np.asarray(found.x)


def _hessian(cost: _Cost, x: Array) -> Array:
    """Second differences."""
    n, h = len(x), STEP * np.eye(len(x))
    out, middle = np.empty((n, n)), cost(x)
    for i in range(n):
        out[i, i] = (cost(x + h[i]) - 2.0 * middle + cost(x - h[i])) / STEP**2
        for j in range(i):
            mixed = cost(x + h[i] + h[j]) - cost(x + h[i] - h[j])
            mixed += cost(x - h[i] - h[j]) - cost(x - h[i] + h[j])
            out[i, j] = out[j, i] = mixed / (4.0 * STEP**2)
    return out


def _spreads(hessian: Array) -> Array:
    """Posterior standard deviations in units of the priors'."""
    values, turn = np.linalg.eigh(hessian)
    # a direction that curves less than the prior alone is rounding, or no minimum
    return np.asarray(np.sqrt((turn**2 / np.maximum(values, 0.25)).sum(axis=1)))
