"""What a shell point samples of the field: the place at its own depth below the skin.

A point at (r, θ, z) lies d = R(θ, z) − r below the skin. On a spoke (θ_j, z_k) of the
grid the place at that depth is ρ = R_jk − d. The layer nearest to R_jk holds the skin;
a is the layer below it, the outermost one that is sampled. Along the spoke

    p(ρ) = linear between the layers          r_inner ≤ ρ ≤ r_a
    p(ρ) = p_a · d / (R_jk − r_a)             r_a ≤ ρ ≤ R_jk
    p(ρ) = p of the inner layer               ρ < r_inner

- ``trilinear``: bilinear between the four spokes of the point's (θ, z) cell. It is
  continuous in the pose, 0 at the skin, and nowhere negative where the field inside is
  not; R_jk − r_a is half a radial step to one and a half.
- ``voxel-mean`` (the paper): the nearest voxel. A point that has not passed the inner
  face of the skin's layer, by radius and by depth on its spoke, samples nothing: the
  paper ignores values below zero, and 0 is the skin's own. Force starts from 0 at first
  touch; where a point crosses a voxel's face it jumps, as in the paper. Beyond r_inner
  all points on a spoke share the inner layer's voxel, and its means.

In both, what lies outside or on the skin's layer is never sampled, so that touch cannot
pull where the field inside is positive. Linear in p. The rows of the fit
(`ttus_opt.contact.rows`) and the haptic frame (`ttus_opt.haptic.frame`) sample by these
functions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array
from ttus_opt.compiled import compiled
from ttus_opt.voxmap.grid import flat_index
from ttus_opt.voxmap.voxmap import Voxmap, skin_layer


def spoke_table(voxmap: Voxmap) -> Array:
    """The skin on every spoke of the grid, from grid and surface alone.

    Args:
        voxmap: Grid and surface.

    Returns:
        Per spoke, in C order of (j, k): the skin's place, (R_jk − r_inner)/Δr; the
        outermost sampled layer a; and 1 / (place − a). Shape (n_θ·n_z, 3) [layers].
    """
    grid = voxmap.grid
    radius = voxmap.surface.radius_at(grid.theta[:, None], grid.z)
    place = (radius - grid.r_inner) / grid.r_step
    outermost = skin_layer(grid, radius) - 1.0
    table = np.stack([place, outermost, 1.0 / (place - outermost)], axis=-1)
    return np.ascontiguousarray(table.reshape(-1, 3))


@compiled(inline="always")
def spoke_cell(
    theta: float, z: float, limits: Array, shape: NDArray[np.int64]
) -> tuple[int, int, int, float, float]:
    """The four spokes around a place (compiled).

    Returns:
        j, the next j, and k of the cell's corner, then its local (θ, z) in [0, 1].
    """
    v = theta * limits[3]
    j = min(int(v), shape[1] - 1)
    j_next = j + 1
    if j_next == shape[1]:
        j_next = 0
    w = (z - limits[4]) * limits[5]
    k = min(int(w), shape[2] - 2)
    return j, j_next, k, v - j, w - k


@compiled(inline="always")
def on_spoke(
    depth: float, place: float, outermost: float, slope: float
) -> tuple[int, float, float]:
    """Where along a spoke a depth lies; lengths in radial steps (compiled).

    Args:
        depth: d / Δr.
        place: Of the skin, above the inner layer.
        outermost: The outermost layer that is sampled.
        slope: 1 / (place − outermost).

    Returns:
        A layer, its share, and the share of the next one outwards.
    """
    reached = min(depth, place)  # the inner layer's value goes on beyond it
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
    limits: Array,
    shape: NDArray[np.int64],
    spokes: Array,
) -> tuple[int, bool]:
    """Flat index of the voxel a point lies in, and whether it samples it (compiled)."""
    i = max(int((r - limits[0]) * limits[1] + 0.5), 0)
    j = int(theta * limits[3] + 0.5)
    if j >= shape[1]:
        j -= shape[1]
    k = int((z - limits[4]) * limits[5] + 0.5)
    spoke = flat_index(0, j, k, shape[1], shape[2])
    outermost = spokes[spoke, 1]
    below = spokes[spoke, 0] - depth * limits[1]  # place at this depth on the spoke
    voxel: int = flat_index(i, j, k, shape[1], shape[2])
    return voxel, i <= outermost and below < outermost + 0.5


@compiled(inner=True)
def spoke_samples(
    theta: float,
    z: float,
    depth: float,
    limits: Array,
    shape: NDArray[np.int64],
    spokes: Array,
    voxels: NDArray[np.int64],
    shares: Array,
) -> int:
    """Voxels and shares of one point, trilinear (compiled).

    Args:
        theta: Angle in [0, 2π) [rad].
        z: Height [m].
        depth: Below the skin [m].
        limits: `CylindricalGrid.kernel_limits`.
        shape: Voxel counts, shape (3,).
        spokes: `spoke_table`.
        voxels: Out: flat indices, shape (8,).
        shares: Out: their shares, shape (8,).

    Returns:
        How many there are.
    """
    j, j_next, k, v, w = spoke_cell(theta, z, limits, shape)
    steps, count = depth * limits[1], 0
    for corner in range(4):
        cj, ck = corner >> 1, corner & 1
        spoke = flat_index(0, j_next if cj else j, k + ck, shape[1], shape[2])
        i, low, high = on_spoke(
            steps, spokes[spoke, 0], spokes[spoke, 1], spokes[spoke, 2]
        )
        part = (v if cj else 1.0 - v) * (w if ck else 1.0 - w)
        voxels[count] = flat_index(i, 0, spoke, shape[1], shape[2])
        shares[count] = part * low
        count += 1
        if high > 0.0:
            voxels[count] = flat_index(i + 1, 0, spoke, shape[1], shape[2])
            shares[count] = part * high
            count += 1
    return count
