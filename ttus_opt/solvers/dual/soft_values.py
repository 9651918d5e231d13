"""The next working set of soft values, by one V-cycle where `system` solves.

A fixed voxel s whose value is drawn to b_s by a row of its own, p_s ≥ l_s, follows from
the multipliers y of the measured rows alone:

    p_s = max(l_s, b_s + ω_s q_s),    q = L⁻ᵀDᵀy,

so that y + D p(y) = t is all that is to be solved, piecewise linear in y. From the
minimiser of a working set on it is solved for the change of y, by the semismooth Newton
method, each step a working set, with the V-cycles of `preconditioner` in the box around
the contact. What they err by is mended from set to set, as the next minimiser is exact
again. Soft values beyond that box stay as the last minimiser has them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.solvers.dual.conjugate_gradients import (
    RecycledSubspace,
    conjugate_gradients,
)
from ttus_opt.solvers.dual.linear_parameters import Complement
from ttus_opt.solvers.dual.options import Accuracy, DualOptions
from ttus_opt.solvers.dual.preconditioner import ApproximateSchur, SchurPreconditioner
from ttus_opt.solvers.dual.system import DualSystem

#: Most steps of Newton's method
STEPS = 12

#: Relative residual of one, and most directions to reach it in: where measurements
#: weigh so much that single precision stands in the way, there is no prediction
RESIDUAL, MOST_DIRECTIONS = 1e-2, 100


@dataclass
class SoftValues:
    """How soft values answer to the multipliers of measured rows.

    Attributes:
        system: The dual without limits.
        options: Of the method.
    """

    system: DualSystem = field(repr=False)
    options: DualOptions

    def __post_init__(self) -> None:
        """Set up the V-cycle around the contact."""
        self._whole = ApproximateSchur(self.system)
        self._options = replace(self.options, max_directions=MOST_DIRECTIONS)
        self._failed = False

    @property
    def voxels(self) -> IntArray:
        """The soft values that it knows of, shape (k,)."""
        return np.asarray(self._whole.fixed, dtype=np.int64)

    def held(self, p: Array, natural: Array, lower: Array) -> Mask | None:
        """Which of them are at their lower limit next, shape (k,); None if unknown.

        Args:
            p: Their values at the minimiser of a working set, shape (k,).
            natural: What they would be without limits, b + ω q, shape (k,).
            lower: Their limits, shape (k,).
        """
        whole, compliance = self._whole, self.system.compliance[self.voxels]
        held = natural < lower
        seen: set[bytes] = set()
        precondition: SchurPreconditioner | None = None
        for _ in range(0 if self._failed else STEPS):
            seen.add(held.tobytes())
            left = whole.without(held)
            precondition = precondition or SchurPreconditioner(left, self.options)
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
        """The change of y in a working set, roughly, (m,); None if it is not found."""
        space = Complement(np.zeros((len(side), 0)), precondition)
        goal = RESIDUAL * float(np.linalg.norm(side))
        subspace, options = RecycledSubspace(left), self._options
        args = (subspace, side, goal, space, Accuracy(0.0), options)
        change = conjugate_gradients(*args)[0]
        rest = subspace.project(side)[1]
        return change if np.linalg.norm(rest) <= goal else None
