"""Constraint-based proxy with 6 degrees of freedom: Gauss' least constraint.

The proxy is the whole probe, held out of the patient. Among small motions ξ = (δ, θ) of
the probe from its pose it takes the smallest, in the metric M = diag(1, ℓ²) of its
inertia, that leaves no shell point below the surface:

    min ½ ξᵀ M ξ   subject to   n_m·(δ + θ × r_m) ≥ d_m   for every point m,

which is the constrained acceleration of the proxy towards the hand's pose. The
constraints are linearised anew at the proxy's pose. A coupling between hand and proxy
gives the wrench k M ξ, a sum of contact forces along the surface's normals that never
pull.

Source: M. Ortega, S. Redon, S. Coquillart, A six degree-of-freedom god-object method
for haptic display of rigid bodies with surface properties, IEEE Trans. Vis. Comput.
Graphics 13 (2007) 458–469; on point clouds F. Rydén, H. J. Chizeck, A method for
constraint-based six degree-of-freedom haptic interaction with streaming point clouds,
ICRA 2013, 2353–2359. The least motion is found by non-negative least squares (C. L.
Lawson, R. J. Hanson, Solving Least Squares Problems, 1974, ch. 23).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from ttus_opt.comparators.base import OneStiffness
from ttus_opt.core.arrays import Array

#: Linearisations; the last moves the proxy by less than 0.1 mm
STEPS = 4

#: Points within this height above the surface constrain the motion [m]
NEAR = 0.03

#: Compliance of infeasible constraints, over that of the coupling [–]
SOFT = 0.3

#: Residual of the dual below which the constraints are infeasible [–]
LEAST_REST = 1e-10


class ProxySixDof(OneStiffness):
    """A constrained proxy of the whole probe, one stiffness of the coupling."""

    name = "proxy_six_dof"
    summary = "6-DOF proxy, constrained acceleration (Ortega 2007; Rydén 2013)"
    stiffness_unit = "N/m"

    def _unit_wrench(self, R: Array, at: Array) -> tuple[Array, int]:
        geometry, length = self.geometry, self.shell.rms_radius
        first = geometry.touch(R, at)
        if not len(first):
            return np.zeros(6), 0
        reference = first.reference
        local = self.shell.points - self.shell.reference
        motion = np.zeros(6)  # δ, then ℓ θ: the metric is then the identity
        for _ in range(STEPS):
            turn = Rotation.from_rotvec(motion[3:] / length).as_matrix()
            arm = local @ (turn @ R).T
            depth, normals = geometry.surface.depth(reference + motion[:3] + arm)
            near = depth > -NEAR
            rows = np.hstack(
                [normals[near], np.cross(arm[near], normals[near]) / length]
            )
            # constraints on the whole motion, including the previous steps
            motion = least_motion(rows, depth[near] + rows @ motion)
        return np.concatenate([motion[:3], motion[3:] * length]), len(first)


def least_motion(rows: Array, least: Array) -> Array:
    """The shortest ξ with rows ξ ≥ least, by its dual.

    Infeasible constraints, deep in the patient, are relaxed with the compliance `SOFT`.

    Args:
        rows: Constraints, shape (k, n).
        least: Shape (k,).

    Returns:
        ξ = rowsᵀ λ with λ ≥ 0, shape (n,).
    """
    n = rows.shape[1]
    if not (least > 0.0).any():
        return np.zeros(n)
    motion = _shortest(rows, least)
    if motion is None:
        soft = np.hstack([rows, SOFT * np.eye(len(rows))])
        motion = _shortest(soft, least)
    assert motion is not None  # relaxed constraints are feasible
    return motion[:n]


def _shortest(rows: Array, least: Array) -> Array | None:
    """The shortest ξ, or None where the constraints are infeasible."""
    n, scale = rows.shape[1], float(least.max())
    matrix = np.vstack([rows.T, least / scale])
    target = np.zeros(n + 1)
    target[n] = 1.0
    multipliers, _ = nnls(matrix, target, maxiter=50 * len(least))
    rest = matrix @ multipliers - target
    if abs(rest[n]) < LEAST_REST:
        return None
    return np.asarray(-scale * rest[:n] / rest[n])
