"""How a shell point samples the field: at its own depth on the neighbouring spokes.

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

In both, nothing on or outside the surface layer is sampled, so that contact cannot pull
where the field inside is positive. Both are linear in p. The rows of the fit
(`ttus_opt.contact.rows`) and the haptic frame (`ttus_opt.haptic.frame`) share these
functions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.voxmap.grid import GridLimits, flat_index, spoke_place
from ttus_opt.voxmap.voxmap import Voxmap, surface_layer


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
