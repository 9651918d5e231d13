"""How contact samples a field: every shell point at its depth on the spokes around it.

A point at (r, θ, z) lies d = R(θ, z) − r below the surface. On a spoke (θ_j, z_k) of
the grid the same depth is at ρ = R_jk − d. The layer nearest to R_jk holds the surface;
a is the layer below it, the outermost one that is sampled. Along the spoke

    p(ρ) = linear between the layers          r_inner ≤ ρ ≤ r_a
    p(ρ) = p_a · d / (R_jk − r_a)             r_a ≤ ρ ≤ R_jk
    p(ρ) = p of the inner layer               ρ < r_inner

- ``trilinear``: bilinear between the four spokes of the point's (θ, z) cell. It is
  continuous in the pose, 0 at the surface, and not negative where the field inside is
  not; R_jk − r_a is half a radial step to one and a half.
- ``voxel-mean`` (the paper): the nearest voxel. A point that has not passed the inner
  face of the surface layer, by radius and by depth on its spoke, samples nothing: the
  paper ignores negative values, and the surface layer's value is 0. Force starts from 0
  at first touch and jumps where a point crosses a voxel's face, as in the paper. Below
  r_inner all points on a spoke share the inner layer's voxel and its means.
- ``contact-size:0.018`` is ``trilinear`` times a factor of the contact patch
  (`ttus_opt.contact.contact_size`) with ℓ₀ = 18 mm: a patch that is much shorter
  samples as ``trilinear`` does, of one that is much longer the stiffness per area
  decreases like 1/ℓ.

In all, nothing on or outside the surface layer is sampled, so that contact cannot pull
where the field inside is positive. All are linear in p. The rows of the fit
(`ttus_opt.contact.rows`) and the haptic frame (`ttus_opt.haptic.frame`) share these
functions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.core.errors import InputError
from ttus_opt.voxmap.grid import GridLimits, flat_index, spoke_place
from ttus_opt.voxmap.voxmap import Voxmap, surface_layer

#: Unit of the field for each sampling (docs/method/contact.md, Unit of the field)
FIELD_UNIT: dict[str, str] = {
    "voxel-mean": "N",
    "trilinear": "N cm-2",
    "contact-size": "N cm-2",
}

SIZED = "contact-size"

#: ℓ₀ where none is given [m]
LEAST_LENGTH = 0.005

#: Smallest and largest ℓ₀: of a grain of sand, of a patient [m]
LENGTHS = 1e-4, 1.0


def check_sampling(sampling: str) -> None:
    """Check the name of a sampling.

    Raises:
        InputError: There is no such sampling, or its length is not usable.
    """
    name, _, length = sampling.partition(":")
    if name not in FIELD_UNIT or (":" in sampling and name != SIZED):
        raise InputError(
            f"sampling must be one of {', '.join(FIELD_UNIT)}, {SIZED}:LENGTH in m, "
            f"got {io.shortened(sampling)}"
        )
    if ":" in sampling and not LENGTHS[0] <= _number(length) <= LENGTHS[1]:
        raise InputError(
            f"the length of {SIZED}:LENGTH must be {LENGTHS[0]:g} to {LENGTHS[1]:g} m, "
            f"got {io.shortened(length)}"
        )


def sized(length: float) -> str:
    """``contact-size`` with ℓ₀ in m, to three digits."""
    return f"{SIZED}:{length:.3g}"


def least_length(sampling: str) -> float:
    """ℓ₀ [m]; 0 where the size of a contact does not count."""
    name, _, length = sampling.partition(":")
    if name != SIZED:
        return 0.0
    return float(length) if length else LEAST_LENGTH


def field_unit(sampling: str) -> str:
    """Unit of a field."""
    return FIELD_UNIT[sampling.partition(":")[0]]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def spoke_table(voxmap: Voxmap) -> Array:
    """The surface on every spoke of the grid.

    Returns:
        Per spoke, in C order of (j, k): the surface's place, (R_jk − r_inner)/Δr; the
        outermost sampled layer a; and 1 / (place − a). Shape (n_θ·n_z, 3) [layers].
    """
    place = voxmap.surface_place
    outermost = surface_layer(voxmap.grid, voxmap.spoke_radius) - 1.0
    table = np.stack([place, outermost, 1.0 / (place - outermost)], axis=-1)
    return np.ascontiguousarray(table.reshape(-1, 3))


@compiled(inline="always")
def spoke_cell(
    theta: float, z: float, limits: GridLimits, n_theta: int, n_z: int
) -> tuple[int, int, int, float, float]:
    """The four spokes around a place (compiled).

    Returns:
        j, the next j, and k of the cell's corner, then its local (θ, z) in [0, 1].
    """
    v = spoke_place(theta, limits)
    j = min(int(v), int(limits.last_cell))
    j_next = 0 if j + 1 == n_theta else j + 1
    w = (z - limits.z_min) * limits.per_z
    k = min(int(w), n_z - 2)
    return j, j_next, k, v - j, w - k


@compiled(inline="always")
def on_spoke(
    depth: float, place: float, outermost: float, slope: float
) -> tuple[int, float, float]:
    """Layers and weights of a depth on a spoke; lengths in radial steps (compiled).

    Args:
        depth: d / Δr.
        place: Position of the surface above the inner layer.
        outermost: The outermost layer that is sampled.
        slope: 1 / (place − outermost).

    Returns:
        A layer, its weight, and the weight of the next one outwards.
    """
    reached = min(depth, place)  # constant below the inner layer
    u = place - reached
    i = min(np.floor(u), outermost)
    last = u >= outermost
    return (
        int(i),
        reached * slope if last else 1.0 - (u - i),
        0.0 if last else u - i,
    )


@compiled(inline="always")
def nearest_voxel(
    r: float,
    theta: float,
    z: float,
    depth: float,
    limits: GridLimits,
    shape: NDArray[np.int64],
    spokes: Array,
) -> tuple[int, bool]:
    """Flat index of a point's voxel, and whether the point samples it (compiled)."""
    i = max(int((r - limits.r_inner) * limits.per_r + 0.5), 0)
    j = int(spoke_place(theta, limits) + 0.5)
    if j >= shape[1]:
        j -= shape[1]
    k = int((z - limits.z_min) * limits.per_z + 0.5)
    spoke = flat_index(0, j, k, shape[1], shape[2])
    outermost = spokes[spoke, 1]
    below = spokes[spoke, 0] - depth * limits.per_r  # place at this depth on the spoke
    voxel: int = flat_index(i, j, k, shape[1], shape[2])
    return voxel, i <= outermost and below < outermost + 0.5


@compiled(inline="always")
def corner_sample(
    corner: int,
    cell: tuple[int, int, int, float, float],
    steps: float,
    spokes: Array,
    counts: tuple[int, int],
) -> tuple[int, float, float]:
    """Sample on one of the four spokes around a place (compiled).

    Args:
        corner: 0 to 3: twice the next angle, once the next slice.
        cell: `spoke_cell`.
        steps: Depth in radial steps.
        spokes: `spoke_table`.
        counts: n_theta and n_z.

    Returns:
        A voxel's flat index, its weight, and the weight of the next one outwards.
    """
    j, j_next, k, v, w = cell
    cj, ck = corner >> 1, corner & 1
    spoke = flat_index(0, j_next if cj else j, k + ck, counts[0], counts[1])
    i, low, high = on_spoke(steps, spokes[spoke, 0], spokes[spoke, 1], spokes[spoke, 2])
    part = (v if cj else 1.0 - v) * (w if ck else 1.0 - w)
    return flat_index(i, 0, spoke, counts[0], counts[1]), part * low, part * high


@compiled(inner=True)
def spoke_samples(
    theta: float,
    z: float,
    depth: float,
    limits: GridLimits,
    shape: NDArray[np.int64],
    spokes: Array,
    voxels: NDArray[np.int64],
    shares: Array,
) -> int:
    """Voxels and weights of one point, trilinear (compiled).

    Args:
        theta: Angle in [0, 2π) [rad].
        z: Height [m].
        depth: Below the surface [m].
        limits: `CylindricalGrid.kernel_limits`.
        shape: Voxel counts, shape (3,).
        spokes: `spoke_table`.
        voxels: Out: flat indices, shape (8,).
        shares: Out: their weights, shape (8,).

    Returns:
        Number of voxels.
    """
    counts = (shape[1], shape[2])
    cell = spoke_cell(theta, z, limits, counts[0], counts[1])
    steps, count = depth * limits.per_r, 0
    for corner in range(4):
        voxel, low, high = corner_sample(corner, cell, steps, spokes, counts)
        voxels[count], shares[count] = voxel, low
        count += 1
        if high > 0.0:
            voxels[count], shares[count] = voxel + counts[0] * counts[1], high
            count += 1
    return count
