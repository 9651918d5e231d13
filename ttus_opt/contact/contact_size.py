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

from typing import NamedTuple

import numpy as np

from ttus_opt.contact.row_kernels import PATCHES, Poses, Rows, walked
from ttus_opt.contact.slip import Slip
from ttus_opt.core.arrays import Array
from ttus_opt.probe.point_shell import PointShell
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

    @classmethod
    def of(cls, rows: Rows) -> Patches:
        """Those that were found with rows."""
        return cls(rows.normal, rows.centre, rows.spread)


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
    poses = np.ascontiguousarray(rotation), np.ascontiguousarray(position)
    return Patches.of(walked(voxmap, shell, Poses(*poses, Slip.none()), PATCHES))


def patch_factors(spread: Array, least: float) -> Array:
    """10 mm/ℓ of patches of a spread [m²], with ℓ₀ [m] [–]."""
    return np.asarray(REFERENCE_LENGTH / np.sqrt(least**2 + 12.0 * spread))


def size_slopes(spread: Array, least: float) -> Array:
    """Slope of ln `patch_factors` over ln ℓ₀, shape (T,) [–]; 0 for ℓ₀ = 0."""
    if not least:
        return np.zeros(len(spread))
    return np.asarray(-(least**2) / (least**2 + 12.0 * spread))
