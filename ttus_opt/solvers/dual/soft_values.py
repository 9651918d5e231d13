"""Prediction of the next working set of soft values.

A fixed voxel s whose own row pulls it to the value b_s, with p_s ≥ l_s, follows from
the multipliers y of the measured rows alone:

    p_s = max(l_s, b_s + ω_s q_s),    q = L⁻ᵀDᵀy.

Only y + D p(y) = t remains to be solved, which is piecewise linear in y. Starting from
the minimiser of a working set, it is solved for the change of y by the semismooth
Newton method, each step of which is a working set, with the V-cycles of
`preconditioner` in the box around the contact. Their error does not accumulate, because
the next minimiser is accurate again. Soft values outside that box keep their state.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.solvers.conjugate_gradients import (
    RecycledSubspace,
    conjugate_gradients,
    norm,
)
from ttus_opt.solvers.dual.preconditioner import ApproximateSchur, SchurPreconditioner
from ttus_opt.solvers.dual.system import DualSystem

#: Most steps of Newton's method
STEPS = 12

#: Relative residual of a step, and most directions to reach it: with measurements too
#: heavy for single precision there is no prediction
RESIDUAL, MOST_DIRECTIONS = 1e-2, 100


@dataclass
class SoftValues:
    """Response of soft values to the multipliers of measured rows.

    Attributes:
        system: The dual without limits.
    """

    system: DualSystem = field(repr=False)

    def __post_init__(self) -> None:
        """Set up the V-cycle around the contact."""
        self._whole = ApproximateSchur(self.system)
        self._failed = False

    @property
    def voxels(self) -> IntArray:
        """The voxels of the soft values in the box, shape (k,)."""
        return np.asarray(self._whole.fixed, dtype=np.int64)

    def held(self, p: Array, natural: Array, lower: Array) -> Mask | None:
        """Which soft values are at their lower limit next, shape (k,); None if unknown.

        Args:
            p: Their values at the minimiser of a working set, shape (k,).
            natural: Their values without limits, b + ω q, shape (k,).
            lower: Their lower limits, shape (k,).
        """
        whole, compliance = self._whole, self.system.compliance[self.voxels]
        held = natural < lower
        seen: set[bytes] = set()
        precondition: SchurPreconditioner | None = None
        for _ in range(0 if self._failed else STEPS):
            seen.add(held.tobytes())
            left = whole.without(held)
            precondition = precondition or SchurPreconditioner(left)
            side = -whole.measured(np.where(held, lower, natural) - p)
            change = self._solved(left, side, precondition)
            if change is None:
                self._failed = True
                break
            held = natural + compliance * whole.slope(change) < lower
            if held.tobytes() in seen:
                break
        return None if self._failed else held

    def _solved(
        self, left: ApproximateSchur, side: Array, precondition: SchurPreconditioner
    ) -> Array | None:
        """Approximate change of y in a working set, (m,); None if it is not found."""
        goal = RESIDUAL * norm(side)
        run = conjugate_gradients(
            RecycledSubspace(left),
            side,
            precondition,
            lambda _, rest: norm(rest) <= goal,
            MOST_DIRECTIONS,
        )
        return run.y if norm(run.rest) <= goal else None
