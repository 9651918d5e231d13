"""The mode of a posterior over a few numbers, from their prior and evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize

from ttus_opt.arrays import Array


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
    """Maximise log evidence − ½ |steps|² by the simplex of Nelder and Mead.

    The evidence has no cheap gradient, and differences below 0.1 in its logarithm do
    not matter.

    Args:
        log_evidence: Function of the steps from the prior's medians, shape (n,).
        n: Number of parameters.
        calls: Most evaluations.
        starts: Alternatives to starting at the medians, shape (n,) each. The most
            likely one is used, because a simplex finds a local maximum.
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
