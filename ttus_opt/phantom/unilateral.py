"""Unilateral contact: forces that push and never pull.

The linear complementarity problem

    f ≥ 0,   C f − s ≥ 0,   f · (C f − s) = 0

for nodal forces f [N], compliance C [m/N] and probe depths s [m] has one solution if C
is positive definite. With C = RᵀR it is the optimality condition of the nonnegative
least-squares problem min ‖R f − R⁻ᵀs‖² over f ≥ 0 (Lawson and Hanson, Solving Least
Squares Problems, 1974, chapter 23).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError


def solve_unilateral(compliance: Array, depth: Array) -> Array:
    """Find the nodal forces that keep the skin out of the probe.

    Args:
        compliance: Symmetric positive definite, shape (n, n) [m/N].
        depth: How far the probe reaches below each node, shape (n,) [m].

    Returns:
        Inward nodal forces on the skin, zero where it does not touch, (n,) [N].

    Raises:
        InputError: The shapes disagree, or the compliance is not positive definite.
    """
    n = len(depth)
    if compliance.shape != (n, n):
        raise InputError(
            f"compliance must be ({n}, {n}) for {n} depths, got {compliance.shape}"
        )
    try:
        R = cholesky(compliance)
    except np.linalg.LinAlgError as error:
        raise InputError(
            "compliance is not positive definite: compute it again"
        ) from error
    forces, _ = nnls(R, solve_triangular(R, depth, trans="T"))
    return np.asarray(forces)
