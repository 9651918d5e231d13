"""Contacts that reach beyond a sector or an end of the grid, where nothing pushes back.

Such a frame is fitted and rendered as if only the part on the grid touched.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
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
