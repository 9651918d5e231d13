"""Flexible conjugate gradients (Notay, SIAM J. Sci. Comput. 22, 2000).

Polak and Ribière's rule allows a preconditioner that is slightly nonlinear.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.solvers.primal.conjugate_gradients import inner_product

Map = Callable[[Array], Array]


@dataclass(frozen=True)
class Step:
    """Result of `flexible_conjugate_gradients`.

    Attributes:
        d: The solution, shape (n,).
        steps: Steps taken [–].
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
        product: v ↦ H v, in a new array.
        side: Right-hand side, shape (n,).
        precondition: v ↦ about H⁻¹ v.
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
        image *= -alpha  # the change of the residual
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
