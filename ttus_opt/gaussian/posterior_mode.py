"""The mode of a posterior over a few numbers, from their prior and evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize

from ttus_opt.core.arrays import Array

#: Step of differences, and largest distance from the prior's medians, in standard
#: deviations of the prior [–]
STEP, FARTHEST = 1e-3, 6.0

#: Relative change of the log posterior, and its slope, below which the search ends [–]
ENOUGH, LEVEL = 1e-5, 1e-2


class PosteriorMode(NamedTuple):
    """Result of `posterior_mode`.

    Attributes:
        steps: The numbers, in standard deviations of the prior, shape (n,) [–].
        log_posterior: Log evidence plus log prior, up to a constant [–].
    """

    steps: Array
    log_posterior: float


def posterior_mode(
    log_evidence: Callable[[Array], float],
    n: int,
    calls: int,
    starts: Sequence[Array] = (),
) -> PosteriorMode:
    """Maximise log evidence − ½ |steps|² by L-BFGS with differences for a gradient.

    Args:
        log_evidence: Function of the steps from the prior's medians, shape (n,).
        n: Number of parameters.
        calls: Most evaluations, but for those of the starts and of a last gradient.
        starts: Alternatives to starting at the medians, shape (n,) each. The search
            finds a local maximum, from the most likely of all.
    """

    def cost(steps: Array) -> float:
        return float(0.5 * steps @ steps - log_evidence(steps))

    def cost_and_slope(steps: Array) -> tuple[float, Array]:
        here = cost(steps)
        beside = [cost(steps + STEP * unit) for unit in np.eye(n)]
        return here, (np.array(beside) - here) / STEP

    found = scipy.optimize.minimize(
        cost_and_slope,
        min((np.zeros(n), *starts), key=cost) if starts else np.zeros(n),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-FARTHEST, FARTHEST)] * n,
        options={
            "ftol": ENOUGH,
            "gtol": LEVEL,
            "maxfun": max(calls // (n + 1), 1),
        },
    )
    return PosteriorMode(np.asarray(found.x), -float(found.fun))
