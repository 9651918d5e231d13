"""The contact patch of a pose: its normal, its centre, its length.

The stiffness per area of an elastic half-space decreases with the size of the indenter,
k ∝ 1/a; that of a thin layer does not. With w_m = a_m d_m, area times depth, and
c = Σ w_m x_m / Σ w_m, the patch has the length

    ℓ² = ℓ₀² + 12 Σ w_m ‖x_m − c‖² / Σ w_m,

which is 2a for the round patch below a ball, or the length of a strip. A point has no
weight when it comes into contact, so ℓ is continuous in the pose; ℓ₀ keeps it positive
at first touch, and patches that are shorter count as on a thin layer. The sampling
``contact-size`` is the trilinear one times 10 mm/ℓ: it is linear in p, and with p ∝ d
and a small ℓ₀ a ball's force grows like d^{3/2}, as in Hertz contact. See
docs/method/contact.md, Contact size.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ttus_opt.contact.row_kernels import (
    ShellArrays,
    beside,
    rotated,
    shell_arrays,
    within,
)
from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.probe.cylindrical import turn_angle
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.radius_lookup import RadiusLayout, radius_between, radius_cell
from ttus_opt.voxmap.grid import GridLimits, depth_at
from ttus_opt.voxmap.sampling import LEAST_LENGTH
from ttus_opt.voxmap.voxmap import Voxmap

#: Length of a patch at which `contact-size` equals `trilinear` [m]
REFERENCE_LENGTH = 0.01


class Patches(NamedTuple):
    """The patches of T poses; all is zero without contact.

    Attributes:
        normal: Mean unit normal, into the probe, patient axes, shape (T, 3) [–].
        centre: c from the shell's reference point, patient axes, shape (T, 3) [m].
        spread: Mean square distance from c, shape (T,) [m²].
    """

    normal: Array
    centre: Array
    spread: Array


def patches_of(
    voxmap: Voxmap, shell: PointShell, rotation: Array, position: Array
) -> Patches:
    """The patches of poses.

    Args:
        voxmap: Grid and surface.
        shell: The probe.
        rotation: Probe to patient, shape (T, 3, 3) [–].
        position: Origin of the probe frame, patient frame, shape (T, 3) [m].
    """
    surface = voxmap.surface
    return Patches(
        *_patches(
            np.ascontiguousarray(rotation),
            np.ascontiguousarray(position),
            shell_arrays(shell),
            voxmap.grid.kernel_limits,
            (np.ascontiguousarray(surface.radius), surface.kernel_layout),
        )
    )


def size_factors(
    voxmap: Voxmap,
    shell: PointShell,
    rotation: Array,
    position: Array,
    least: float = LEAST_LENGTH,
) -> Array:
    """10 mm/ℓ of every pose, shape (T,) [–]; 10 mm/ℓ₀ without contact.

    Args:
        voxmap: Grid and surface.
        shell: The probe.
        rotation: As of `patches_of`.
        position: As of `patches_of`.
        least: ℓ₀ [m].
    """
    return patch_factors(patches_of(voxmap, shell, rotation, position).spread, least)


def patch_factors(spread: Array, least: float) -> Array:
    """10 mm/ℓ of patches of a spread [m²], with ℓ₀ [m] [–]."""
    return np.asarray(REFERENCE_LENGTH / np.sqrt(least**2 + 12.0 * spread))


def size_slopes(spread: Array, least: float) -> Array:
    """Slope of ln `patch_factors` over ln ℓ₀, shape (T,) [–]; 0 for ℓ₀ = 0."""
    if not least:
        return np.zeros(len(spread))
    return np.asarray(-(least**2) / (least**2 + 12.0 * spread))


@compiled()
def _patches(
    rotation: Array,
    position: Array,
    shell: ShellArrays,
    limits: GridLimits,
    surface: tuple[Array, RadiusLayout],
) -> tuple[Array, Array, Array]:
    """Mean normal, centre and spread of every pose's contact (compiled).

    Args:
        rotation: Shape (T, 3, 3) [–].
        position: Shape (T, 3) [m].
        shell: `shell_arrays`.
        limits: `CylindricalGrid.kernel_limits`.
        surface: Radius of the nodes [m] and `Surface.kernel_layout`.

    Returns:
        Arrays of `Patches`.
    """
    points, normals, weights, reference = shell
    radius, layout = surface
    (n_theta, n_z), flat = radius.shape, radius.reshape(-1)
    n_poses = len(position)
    normal, centre = np.zeros((n_poses, 3)), np.zeros((n_poses, 3))
    spread = np.zeros(n_poses)
    for t in range(n_poses):
        R, at, total, square = rotation[t], position[t], 0.0, 0.0
        n, c = np.zeros(3), np.zeros(3)  # in the probe frame
        for m in range(len(points)):
            x, y, z = rotated(R, points[m, 0], points[m, 1], points[m, 2])
            x, y, z = x + at[0], y + at[1], z + at[2]
            r_squared = x * x + y * y
            if not within(r_squared, z, limits) or beside(x, y, limits):
                continue
            cell = radius_cell(turn_angle(x, y), z, n_theta, n_z, layout)
            R_here = radius_between(cell[0], cell[1], cell[2], cell[3], flat)
            depth = depth_at(R_here, math.sqrt(r_squared), z, limits)
            if depth <= 0.0:
                continue
            share = weights[m] * depth
            total += share
            for a in range(3):
                n[a] += share * normals[m, a]
                arm = points[m, a] - reference[a]
                c[a] += share * arm
                square += share * arm * arm
        if total == 0.0:
            continue
        mean = (c[0] * c[0] + c[1] * c[1] + c[2] * c[2]) / total
        spread[t] = max(square - mean, 0.0) / total
        length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if length == 0.0:
            continue
        nx, ny, nz = rotated(R, n[0] / length, n[1] / length, n[2] / length)
        normal[t, 0], normal[t, 1], normal[t, 2] = nx, ny, nz
        cx, cy, cz = rotated(R, c[0] / total, c[1] / total, c[2] / total)
        centre[t, 0], centre[t, 1], centre[t, 2] = cx, cy, cz
    return normal, centre, spread
