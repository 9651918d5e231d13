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

    def steps(self, value: float) -> float:
        """How many standard deviations a value is from the median."""
        if self.linear:
            return (value - self.median) / self.spread
        return math.log(value / self.median) / self.spread

    def derivative(self, x: float) -> float:
        """Derivative of `value`; at a bound, from within."""
        low, high = self.range
        if not low <= x <= high:
            return 0.0
        return self.spread if self.linear else self.spread * self.value(x)

    @property
    def range(self) -> tuple[float, float]:
        """The lowest and highest x at which `value` changes."""
        low = self.steps(0.0) if self.linear else -FARTHEST
        return max(low, -FARTHEST), min(self.steps(self.highest), FARTHEST)

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


#: Log density of the data and its derivatives by the values, shape (n,)
Slope = Callable[[Array], tuple[float, Array]]


@dataclass(frozen=True)
class _Peak:
    """A maximum over the free hyperparameters.

    Attributes:
        x: Where, in prior standard deviations from the medians, shape (n,) [–].
        cost: Minus the log posterior there [–].
        hessian: Its second derivatives, shape (n, n) [–].
    """

    x: Array
    cost: float
    hessian: Array


def maximise(log_density: Callable[[Array], float], priors: Sequence[Prior]) -> Maximum:
    """Find the most likely values, and which of them the data determine.

    By the simplex method, the reference for `maximise_by_slope`.

    Args:
        log_density: Log density of the data for values in the order of the priors.
        priors: One or more priors.
    """

    def search(free: Sequence[int], start: Array) -> _Peak:
        def cost(x: Array) -> float:
            return float(0.5 * x @ x - log_density(_values(priors, free, x)))

        x = _minimum(cost, start)
        return _Peak(x, cost(x), _hessian(cost, x))

    return _determined(search, priors, np.zeros(len(priors)))


def maximise_by_slope(
    slope: Slope, priors: Sequence[Prior], start: Sequence[Hyperparameter] = ()
) -> Maximum:
    """The same in a fifth of the evaluations, by a quasi-Newton method.

    Args:
        slope: Log density and derivatives for values in the order of the priors.
        priors: One or more priors.
        start: Values to begin with, by name; for others, the medians.
    """
    known = {one.name: one.value for one in start}
    first = [prior.steps(known.get(prior.name, prior.median)) for prior in priors]

    def search(free: Sequence[int], start: Array) -> _Peak:
        own = [priors[i] for i in free]

        def cost(x: Array) -> tuple[float, Array]:
            value, by_value = slope(_values(priors, free, x))
            chain = [p.derivative(float(s)) for p, s in zip(own, x, strict=True)]
            return float(0.5 * x @ x - value), x - by_value[free] * chain

        x = _descended(cost, start, [prior.range for prior in own])
        return _Peak(x, cost(x)[0], _hessian_by_slope(cost, x))

    return _determined(search, priors, np.array(first))


def _values(priors: Sequence[Prior], free: Sequence[int], x: Array) -> Array:
    """All values, those of hyperparameters that are not free at their medians."""
    steps = np.zeros(len(priors))
    steps[free] = x
    return np.array([p.value(float(s)) for p, s in zip(priors, steps, strict=True)])


def _determined(
    search: Callable[[Sequence[int], Array], _Peak], priors: Sequence[Prior], x: Array
) -> Maximum:
    """Search again without the least certain one, until the data determine all.

    Args:
        search: Finds the maximum over some of them, given their numbers and a start.
        priors: Priors of all.
        x: Where to start, in prior standard deviations, shape (n,) [–].
    """
    free = list(range(len(priors)))
    while True:
        peak = search(free, x[free])
        x[free], spread = peak.x, _spreads(peak.hessian)
        if not free or spread.max() <= DETERMINED:
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
    occam = -0.5 * float(np.linalg.slogdet(peak.hessian)[1])
    return Maximum(found, -peak.cost, occam - peak.cost)


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


def _descended(
    cost: Slope, start: Array, ranges: Sequence[tuple[float, float]]
) -> Array:
    """The minimum within the priors' ranges."""
    if not len(start):
        return start
    found = scipy.optimize.minimize(
        cost,
        start,
        method="L-BFGS-B",
        jac=True,
        bounds=ranges,
        # the prior's curvature of 1 makes the slope a bound of the distance
        options={"gtol": ACCURACY, "ftol": 0.0, "maxfun": MOST},
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


def _hessian_by_slope(cost: Slope, x: Array) -> Array:
    """The same, with differences of slopes off the diagonal.

    At a bound, where the slope jumps, second differences are those of the reference.
    """
    n, h = len(x), STEP * np.eye(len(x))
    out, diagonal, middle = np.empty((n, n)), np.empty(n), cost(x)[0]
    for i in range(n):
        (above, up), (below, down) = cost(x + h[i]), cost(x - h[i])
        out[i] = (up - down) / (2.0 * STEP)
        diagonal[i] = (above - 2.0 * middle + below) / STEP**2
    out = 0.5 * (out + out.T)
    out[np.diag_indices(n)] = diagonal
    return out


def _spreads(hessian: Array) -> Array:
    """Posterior standard deviations in units of the priors'."""
    values, turn = np.linalg.eigh(hessian)
    # the prior alone has curvature 1: much less is rounding, or no minimum
    return np.asarray(np.sqrt((turn**2 / np.maximum(values, 0.25)).sum(axis=1)))
