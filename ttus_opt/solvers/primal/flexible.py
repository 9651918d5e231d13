"""Flexible conjugate gradients (Notay, SIAM J. Sci. Comput. 22, 2000).

Directions are made conjugate by Polak and Ribière's rule, so that a preconditioner need
not be quite linear.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.solvers.primal.conjugate_gradients import inner_product

Map = Callable[[Array], Array]


@dataclass(frozen=True)
class Step:
    """Where conjugate gradients ended.

    Attributes:
        d: The answer, shape (n,).
        steps: Steps spent [–].
    """

    d: Array = field(repr=False)
    steps: int


def flexible_conjugate_gradients(
    product: Map,
    side: Array,
    precondition: Map,
    rtol: float,
    most: int,
    deadline: float | None,
) -> Step:
    """Solve H d = side from zero.

    Args:
        product: H times a vector, as a new one.
        side: Right-hand side, shape (n,).
        precondition: About H⁻¹ times a vector.
        rtol: Relative residual to reach [–].
        most: Most steps [–].
        deadline: `time.perf_counter` at which to stop; None for never [s].
    """
    d, rest = np.zeros_like(side), side.copy()
    first = now = math.sqrt(inner_product(side, side))
    z = precondition(rest)
    direction, steps = z.copy(), 0
    energy = inner_product(rest, z)
    while now > rtol * first and steps < most:
        if deadline is not None and time.perf_counter() > deadline:
            break
        image = product(direction)
        curvature = inner_product(direction, image)
        if not curvature > 0.0:
            break
        alpha = energy / curvature
        d += alpha * direction
        image *= -alpha  # by what the residual changes
        rest += image
        now = math.sqrt(inner_product(rest, rest))
        z = precondition(rest)
        beta = inner_product(z, image) / energy
        energy = inner_product(rest, z)
        if not energy > 0.0:
            break
        direction *= max(beta, 0.0)
        direction += z
        steps += 1
    return Step(d, steps)
