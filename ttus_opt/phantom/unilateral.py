"""Unilateral contact: forces that push and never pull.

The linear complementarity problem

    f ≥ 0,   w = C f,   w − s ≥ 0,   f · (w − s) = 0

for nodal forces f [N], compliance C [m/N] and probe depths s [m]. It is solved
exactly by block principal pivoting with Murty's least-index rule as the fall-back
that makes it finite (Júdice & Pires, Computers & Operations Research 21, 1994).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError, TtusError

#: Block steps without progress before single pivots take over.
PATIENCE = 10


@dataclass(frozen=True)
class NodalForces:
    """The answer of one contact.

    Attributes:
        forces: Inward nodal forces on the skin, none negative, shape (n,) [N].
        displacements: Inward displacements C f, shape (n,) [m].
        active: Nodes that touch, shape (n,).
        pivots: Systems solved [–].
    """

    forces: Array
    displacements: Array
    active: NDArray[np.bool_]
    pivots: int


def solve_unilateral(
    compliance: Array, depth: Array, active: NDArray[np.bool_] | None = None
) -> NodalForces:
    """Find the nodal forces that keep the skin out of the probe.

    Args:
        compliance: Symmetric positive definite, shape (n, n) [m/N].
        depth: How far the probe reaches below each node, shape (n,) [m].
        active: Nodes believed to touch (the last pose's), shape (n,); those below
            the probe's surface when not given.

    Returns:
        Forces, displacements and the touching nodes.

    Raises:
        InputError: Shapes that disagree or a compliance that is not definite.
        TtusError: No answer was found, which definiteness excludes but for rounding.
    """
    n = len(depth)
    if compliance.shape != (n, n):
        raise InputError(
            f"compliance must be ({n}, {n}) for {n} depths, got {compliance.shape}"
        )
    touching = depth > 0.0 if active is None else active.copy()
    # Rounding of a solve must not look like a violation.
    slack = 1e-12 * float(np.abs(depth).max(initial=0.0))
    best, patience = n + 1, PATIENCE
    for pivot in range(1, 20 * n + 50):
        forces = _solve_touching(compliance, depth, touching)
        displacements = compliance @ forces
        wrong = np.where(touching, forces < 0.0, displacements - depth < -slack)
        n_wrong = int(wrong.sum())
        if n_wrong == 0:
            return NodalForces(forces, displacements, touching, pivot)
        if n_wrong < best:
            best, patience = n_wrong, PATIENCE
        elif patience > 0:
            patience -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        touching = touching ^ wrong
    raise TtusError(
        f"no contact state found for {n} nodes: check that the compliance is "
        "symmetric positive definite"
    )


def _solve_touching(
    compliance: Array, depth: Array, touching: NDArray[np.bool_]
) -> Array:
    """Forces that bring the touching nodes to the probe; zero elsewhere [N]."""
    forces = np.zeros(len(depth))
    index = np.flatnonzero(touching)
    if index.size:
        block = compliance[np.ix_(index, index)]
        try:
            factor = cho_factor(block, lower=True, check_finite=False)
        except np.linalg.LinAlgError as error:
            raise InputError(
                "compliance is not positive definite: compute it again"
            ) from error
        forces[index] = cho_solve(factor, depth[index], check_finite=False)
    return forces
