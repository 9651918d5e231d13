"""Conjugate gradients in the dual, every direction kept.

The dual is small (a few thousand rows) while each product costs two solves over all
voxels, so all directions are kept and each new one is made conjugate to all of them.
Plain conjugate gradients lose that to rounding when K has eigenvalues of 1e5 and
more and then repeat themselves (150 steps and more where these take 75). Kept
directions also answer other right sides, and other weights, at no solve at all.

Products are as inexact as the residual allows, an error in a late, short step does
little harm (Bouras and Frayssé, SIAM J. Matrix Anal. Appl. 26, 2005).
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ttus_opt.laplace import RTOL
from ttus_opt.solvers.dual_system import DualSystem

Array = NDArray[np.float64]

#: Loosest solve inside a product [–]
LOOSEST = 1e-6

#: Directions whose norm falls below this part of the largest are dropped [–]
DEPENDENT = 1e-12


class Directions:
    """Conjugate directions of one dual system, growing as right sides ask for them.

    Directions are kept without weights (c·d and c⁻¹·K d), so that a change of the
    weights makes them conjugate again without a solve.
    """

    def __init__(self, system: DualSystem) -> None:
        m = len(system.root_weights)
        self.system = system
        self._bare = np.zeros((0, m))  # c · d
        self._bare_image = np.zeros((0, m))  # K d / c
        self._d = np.zeros((0, m))  # conjugate, normalised
        self._image = np.zeros((0, m))  # (I + K) d

    def __len__(self) -> int:
        """Number of directions."""
        return len(self._d)

    def adopt(self, system: DualSystem) -> None:
        """Take a system that differs by its weights; no solve is spent.

        Args:
            system: A system for which ``same_rows`` holds.
        """
        self.system = system
        c = system.root_weights
        d = self._bare / c
        image = d + self._bare_image * c
        gram = d @ image.T
        size, turn = np.linalg.eigh((gram + gram.T) / 2.0)
        keep = size > DEPENDENT * size.max(initial=0.0)
        mix = (turn[:, keep] / np.sqrt(size[keep])).T
        self._d, self._image = mix @ d, mix @ image
        self._bare, self._bare_image = mix @ self._bare, mix @ self._bare_image

    def project(self, right_side: Array) -> tuple[Array, Array]:
        """Best y in the span of what is kept, and the residual it leaves.

        Args:
            right_side: Shape (m,).

        Returns:
            y and right_side - (I + K) y, shape (m,) each.
        """
        parts = self._d @ right_side
        return parts @ self._d, right_side - parts @ self._image

    def extend(self, direction: Array, rtol: float) -> None:
        """Make a direction conjugate to the others, normalise and keep it.

        Args:
            direction: Shape (m,).
            rtol: Relative residual of the solves in its product.
        """
        for _ in range(2):  # twice is enough
            direction = direction - (self._image @ direction) @ self._d
        image = self.system.apply(direction, rtol)
        size = float(np.sqrt(direction @ image))
        direction, image = direction / size, image / size
        c = self.system.root_weights
        self._d = np.vstack([self._d, direction])
        self._image = np.vstack([self._image, image])
        self._bare = np.vstack([self._bare, c * direction])
        self._bare_image = np.vstack([self._bare_image, (image - direction) / c])


def solve_dual(
    directions: Directions,
    right_side: Array,
    goal: float,
    precondition: Callable[[Array], Array],
    *,
    max_steps: int,
    deadline: float | None,
) -> tuple[Array, int]:
    """Solve (I + K) y = right_side until ‖residual‖ ≤ goal.

    Args:
        directions: What is known already; extended along the way.
        right_side: Shape (m,).
        goal: Norm of the residual to reach.
        precondition: Approximation of (I + K)⁻¹, symmetric positive definite.
        max_steps: Most new directions.
        deadline: `time.perf_counter` at which to stop; None for never [s].

    Returns:
        y, shape (m,), and the number of new directions. Whether the goal was reached
        is for the caller to verify.
    """
    y, residual = directions.project(right_side)
    steps = 0
    while (size := float(np.linalg.norm(residual))) > goal and steps < max_steps:
        if deadline is not None and time.perf_counter() > deadline:
            break
        rtol = min(max(0.1 * goal / size, RTOL), LOOSEST)
        directions.extend(precondition(residual), rtol)
        # onto all directions, not the last alone: inexact images leave a rest on each
        step, residual = directions.project(residual)
        y = y + step
        steps += 1
    return y, steps
