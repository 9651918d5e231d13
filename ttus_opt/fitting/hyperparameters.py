"""Hyperparameters with weak priors, by maximum a posteriori.

Weak log-normal priors keep hyperparameters that the data hardly determine near sensible
values. One that is hardly more certain than its prior gets the prior's median and is
reported as not determined.

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

#: Largest posterior standard deviation of a determined hyperparameter, over its prior's
#: [–]
DETERMINED = 0.7

#: Step of the Hessian's differences, in prior standard deviations [–]
STEP = 0.2

#: Largest distance from the median, in prior standard deviations [–]
FARTHEST = 6.0

#: Accuracy of the search, in prior standard deviations and in the log density, and
#: most evaluations of it
ACCURACY, LOG_ACCURACY, MOST = 0.03, 0.05, 500


@dataclass(frozen=True)
class Prior:
    """A weak prior of one hyperparameter.

    Attributes:
        name: Its name.
        median: Median.
        spread: Standard deviation of the logarithm, or of the value if linear [–].
        unit: Its unit.
        linear: Whether the prior is normal and cut at 0, not log-normal.
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
        """Whether the value x standard deviations from the median is a bound."""
        return abs(x) >= FARTHEST or self.value(x) >= self.highest


@dataclass(frozen=True)
class Hyperparameter:
    """An estimated hyperparameter.

    Attributes:
        name: Its name.
        value: The value to use.
        prior_value: The prior's median.
        spread: Posterior standard deviation of the logarithm, or of the value if the
            prior is linear; NaN where not determined [–].
        determined: Whether the data determine it; otherwise the value is the prior's.
        unit: Its unit.
        at_bound: Whether the value lies at the end of its range; a coefficient of 0
            does not count.
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
    """The most likely hyperparameters.

    Attributes:
        found: The hyperparameters, in the order of the priors.
        log_posterior: Log density of data and hyperparameters there [–].
        log_marginal: The same, with the hyperparameters integrated out by Laplace's
            approximation; for comparing models [–].
    """

    found: tuple[Hyperparameter, ...]
    log_posterior: float
    log_marginal: float


def maximise(log_density: Callable[[Array], float], priors: Sequence[Prior]) -> Maximum:
    """Find the most likely values, and which of them the data determine.

    Args:
        log_density: Log density of the data for values in the order of the priors.
        priors: One or more priors.
    """
    free = list(range(len(priors)))
    x = np.zeros(len(priors))

    def cost(of_free: Array) -> float:
        """Minus the log posterior, hyperparameters that are not free at 0."""
        steps = np.zeros(len(priors))
        steps[free] = of_free
        values = [p.value(float(s)) for p, s in zip(priors, steps, strict=True)]
        return float(0.5 * of_free @ of_free - log_density(np.array(values)))

    while True:
        x[free] = _minimum(cost, x[free])
        hessian = _hessian(cost, x[free])
        spread = _spreads(hessian)
        doubtful = [i for i, s in zip(free, spread, strict=True) if s > DETERMINED]
        if not doubtful:
            break
        worst = free[int(np.argmax(spread))]
        x[worst] = 0.0
        free.remove(worst)
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
    peak = -cost(x[free])
    occam = -0.5 * float(np.linalg.slogdet(hessian)[1])
    return Maximum(found, peak, peak + occam)


def _minimum(cost: Callable[[Array], float], start: Array) -> Array:
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


def _hessian(cost: Callable[[Array], float], x: Array) -> Array:
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
    # the prior alone has curvature 1: much less is rounding, or no minimum
    return np.asarray(np.sqrt((turn**2 / np.maximum(values, 0.25)).sum(axis=1)))
