"""Warnings of a scene whose parts fit together badly, or measure little.

A contact may reach beyond a sector or an end of the grid, where nothing pushes back
(`cut_off`): such a frame is fitted and rendered as if only the part on the grid
touched.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.contact.rows import ContactRows
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import MistakeWarning, warn
from ttus_opt.probe.cylindrical import cylindrical
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.voxmap import Voxmap

#: Share of the depth, summed over area, that may lie beyond the grid: about the error
#: of the force, of which a hand feels 7 % [–]
MOST_BEYOND = 0.05


def cut_off(
    voxmap: Voxmap, shell: PointShell, rotation: Array, position: Array
) -> NDArray[np.bool_]:
    """Poses that touch the patient on the grid and, noticeably, beyond it too.

    Args:
        voxmap: Grid and surface.
        shell: The probe.
        rotation: Probe to patient, shape (T, 3, 3) [–].
        position: Origin of the probe frame, patient frame, shape (T, 3) [m].

    Returns:
        Shape (T,).
    """
    grid, cut = voxmap.grid, np.zeros(len(position), dtype=bool)
    reach = float(np.linalg.norm(shell.points, axis=1).max())
    height = position[:, 2]
    near = (height - reach < grid.z_min) | (height + reach > grid.z_max)
    if grid.sector is not None:
        near[:] = True
    for t in np.flatnonzero(near):
        places = shell.points @ rotation[t].T + position[t]
        cut[t] = MOST_BEYOND < _share_beyond(voxmap, places, shell.areas) < 1.0
    return cut


def _share_beyond(voxmap: Voxmap, places: Array, areas: Array) -> float:
    """Share of the depth of points, summed over area, that lies beyond the grid [–]."""
    grid = voxmap.grid
    r, theta, z = cylindrical(places)
    depth = areas * np.maximum(voxmap.surface.radius_at(theta, z) - r, 0.0)
    on_grid = grid.in_sector(theta) & (z >= grid.z_min) & (z <= grid.z_max)
    total = float(depth.sum())
    return 1.0 - float(depth[on_grid].sum()) / total if total > 0.0 else 0.0


def warn_misplaced(voxmap: Voxmap) -> None:
    """Warn where regions do not match the surface."""
    misplaced = voxmap.cut_links.misplaced
    if misplaced:
        warn(
            f"at {misplaced} links of voxels the region is not that of the surface, "
            "which is taken to lie a quarter of a layer beyond: lay the grid over the "
            "surface with Voxmap.from_surface",
            2,
        )


def warn_size(voxmap: Voxmap, shell: PointShell) -> None:
    """Warn of a probe that is larger than the patient."""
    probe = float(np.ptp(shell.points, axis=0).max())
    patient = 2.0 * float(voxmap.surface.radius.max())
    if probe > patient:
        warn(
            f"the probe is {probe:.3g} m long, the patient {patient:.3g} m wide: check "
            "the unit of both",
            2,
            MistakeWarning,
        )


def warn_contact(rows: ContactRows, r_inner: float) -> None:
    """Warn of poses that measure nothing, or reach below the inner layer."""
    n_poses = len(rows.in_grid)
    off = int(n_poses - rows.in_grid.sum())
    if off:
        warn(
            f"{off} of {n_poses} poses lie outside the grid and give zero force: "
            "check the trajectory's frame and unit",
            2,
            MistakeWarning,
        )
    if not rows.touching.any():
        warn(
            f"the probe touches the patient in none of {n_poses} poses: the fit is "
            "the Laplace field alone",
            2,
        )
    deep = int((rows.beyond_inner > 0).sum())
    if deep:
        warn(
            f"{deep} of {n_poses} poses press shell points ({rows.beyond_inner.sum()} "
            f"in all) beyond the inner layer at {r_inner:.4g} m, where that layer's "
            "values continue: choose a smaller r_inner",
            2,
        )


def warn_cut_off(cut: Mask) -> None:
    """Warn of poses that touch beyond the sides or ends of the grid."""
    if cut.any():
        warn(
            f"{cut.sum()} of {len(cut)} poses touch the patient beyond the grid's "
            "sector or ends too, where nothing pushes back: widen the sector, or leave "
            "them out",
            2,
        )
