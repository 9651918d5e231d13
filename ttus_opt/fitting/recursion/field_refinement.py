"""The field of the dual system (I + K) y = d₀, refined by conjugate gradients.

With D the weighted measured rows, K = D L⁻¹L⁻ᵀDᵀ and p₀ the Laplace field, the field is
p = p₀ + L⁻¹L⁻ᵀDᵀ y (`fitting.recursion.dual_recursion`). K is not formed: a round takes
a solve with Lᵀ and one with L. The preconditioner is I + R Rᵀ of the low-rank factor R,
which need not be exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.fitting.recursion.low_rank_kernel import LowRankKernel
from ttus_opt.fitting.recursion.measured_rows import MeasuredRows
from ttus_opt.gaussian.laplace_prior import LaplacePrior
from ttus_opt.laplace.system import RTOL

#: Relative residual of (I + K) y = d₀ to which the field is refined; most iterations
FIELD_RTOL, FIELD_ROUNDS = 1e-9, 30


class Refined(NamedTuple):
    """A field and its dual.

    Attributes:
        shift: p - p₀, shape (V,).
        y: Its multipliers, shape (n,).
        residual: ‖d₀ - D (p - p₀) - y‖ over ‖d₀‖, 0 if at most `FIELD_RTOL` [–].
    """

    shift: Array
    y: Array
    residual: float


def refined(
    prior: LaplacePrior,
    D: MeasuredRows,
    kernel: LowRankKernel,
    d0: Array,
    shift: Array,
    y: Array,
) -> Refined:
    """Refine a field until its dual system holds, or for `FIELD_ROUNDS` rounds.

    The conjugate gradients are flexible because the solves are inexact: Notay, SIAM J.
    Sci. Comput. 22 (2000) 1444-1460.

    Args:
        prior: That of the field.
        D: Measured rows.
        kernel: R, the preconditioner.
        d0: Misfit of p₀, shape (n,).
        shift: p - p₀ at the start, shape (V,).
        y: Its multipliers, shape (n,).
    """
    size = float(np.linalg.norm(d0))
    direction, before, fall = np.zeros_like(d0), np.zeros_like(d0), 1.0
    for _ in range(FIELD_ROUNDS):
        residual = d0 - D.times(shift) - y
        now = float(np.linalg.norm(residual))
        if now <= FIELD_RTOL * size:
            return Refined(shift, y, 0.0)
        step = kernel.solve(residual)
        direction = step + (step @ (residual - before) / fall) * direction
        before, fall = residual, float(step @ residual)
        # a small correction needs less accuracy
        rtol = min(max(RTOL, 0.1 * FIELD_RTOL * size / now), 1e-4)
        response = prior.within(rtol).times(D.adjoint(direction))
        length = direction @ (direction + D.times(response))
        if not (fall > 0.0 and length > 0.0):
            break
        part = float(direction @ residual / length)
        shift, y = shift + part * response, y + part * direction
    residual = d0 - D.times(shift) - y
    return Refined(shift, y, float(np.linalg.norm(residual)) / size)
