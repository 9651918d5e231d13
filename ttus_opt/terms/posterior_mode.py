"""The mode of a posterior over a few numbers, from their prior and evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize

from ttus_opt.arrays import Array


class PosteriorMode(NamedTuple):
    """What `posterior_mode` found.

    Attributes:
        steps: The numbers, in standard deviations of the prior, shape (n,) [–].
        log_posterior: Log evidence and log prior there, but for a constant [–].
    """

    steps: Array
    log_posterior: float


def posterior_mode(
    log_evidence: Callable[[Array], float],
    n: int,
    calls: int,
    starts: Sequence[Array] = (),
) -> PosteriorMode:
    """Maximise log evidence − ½ |steps|² by the simplex of Nelder and Mead.

    Evidence through a factorisation is smooth but has no cheap gradient, and
    differences below a tenth of a unit of its logarithm decide nothing.

    Args:
        log_evidence: Of steps away from the prior's medians, shape (n,).
        n: How many numbers.
        calls: Most evaluations.
        starts: Where else to begin than at the medians, shape (n,) each: a simplex
            finds one hill, and begins where the posterior is largest.
    """

    def cost(steps: Array) -> float:
        return float(0.5 * steps @ steps - log_evidence(steps))

    begin = min((np.zeros(n), *starts), key=cost)
    found = scipy.optimize.minimize(
        cost,
        begin,
        method="Nelder-Mead",
        options={
            "initial_simplex": begin + np.vstack([np.zeros(n), np.eye(n)]),
            "xatol": 0.05,
            "fatol": 0.1,
            "maxfev": calls,
        },
    )
    return PosteriorMode(np.asarray(found.x), -float(found.fun))
