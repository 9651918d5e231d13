"""Length of the contact patch, and its effect on the stiffness.

The stiffness per area of an elastic half-space decreases with the size of the indenter,
k ∝ 1/a; that of a thin layer does not. With w_m = a_m d_m, area times depth, and
c = Σ w_m x_m / Σ w_m, the patch has the length

    ℓ² = ℓ₀² + 12 Σ w_m ‖x_m − c‖² / Σ w_m,

which is 2a for the round patch below a ball, or the length of a strip. A point has no
weight when it comes into contact, so ℓ is continuous in the pose; ℓ₀ keeps it positive
at first touch. The sampling ``contact-size`` is the trilinear one times 10 mm/ℓ: it is
linear in p, and with p ∝ d a ball's force grows like d^{3/2}, as in Hertz contact. See
docs/method.md, Contact size.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.probe.cylindrical import cylindrical
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.voxmap import Voxmap

#: Length of a patch at which `contact-size` equals `trilinear` [m]
REFERENCE_LENGTH = 0.01

#: ℓ₀, half the reference length, so that the factor is at most 2 [m]
LEAST_LENGTH = 0.005

#: Poses processed at once, which bounds the memory
AT_ONCE = 64


def size_factors(
    voxmap: Voxmap, shell: PointShell, rotation: Array, position: Array
) -> Array:
    """10 mm/ℓ of every pose, shape (T,) [–]; 2 without contact.

    Args:
        voxmap: Grid and surface.
        shell: The probe.
        rotation: Probe to patient, shape (T, 3, 3) [–].
        position: Origin of the probe frame, patient frame, shape (T, 3) [m].
    """
    out = np.empty(len(position))
    for start in range(0, len(position), AT_ONCE):
        part = slice(start, start + AT_ONCE)
        out[part] = _factors(voxmap, shell, rotation[part], position[part])
    return out


def _factors(
    voxmap: Voxmap, shell: PointShell, rotation: Array, position: Array
) -> Array:
    grid = voxmap.grid
    places = np.einsum("tij,mj->tmi", rotation, shell.points) + position[:, None]
    shape = places.shape[:2]
    r, theta, z = (v.reshape(shape) for v in cylindrical(places.reshape(-1, 3)))
    depth = (voxmap.surface.radius_at(theta, z) - r) * grid.end_share(z)
    inside = (r <= grid.r_outer) & grid.in_sector(theta)
    weight = np.where(inside, np.maximum(depth, 0.0), 0.0) * shell.areas
    total = weight.sum(axis=1)
    shares = weight / np.where(total > 0.0, total, 1.0)[:, None]
    centre = shares @ shell.points  # in the probe frame, where lengths are the same
    spread = shares @ (shell.points**2).sum(axis=1) - (centre**2).sum(axis=1)
    square = LEAST_LENGTH**2 + 12.0 * np.maximum(spread, 0.0)
    return np.asarray(REFERENCE_LENGTH / np.sqrt(square))
