"""Arms beside a trunk, told by the gap that sections show between them.

In each section across the axis, what does not hang together with the rest and has less
than `SHARE` of its points is a limb. Legs have half each, and stay.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Array, Mask

#: Height of a section, and the width of cells that must touch: at least, and in typical
#: distances between neighbouring points [m, m, –]
SECTION, CELL, NEIGHBOURS = 0.02, 0.012, 2.5

#: Clouds of fewer points are left as they are
LEAST = 100

#: Largest share of a section's points in a limb [–]
SHARE = 0.3


def trunk(points: Array) -> Mask:
    """Which points (n, 3) [m], patient frame, belong to no limb, shape (n,)."""
    if len(points) < LEAST:
        return np.ones(len(points), bool)
    from scipy.ndimage import label
    from scipy.spatial import cKDTree

    some = points[:: max(1, len(points) // 2000)]
    distance = np.asarray(cKDTree(points).query(some, k=4)[0])
    cell = max(CELL, NEIGHBOURS * float(np.median(distance[:, -1])))
    at = (points - points.min(axis=0)) / [cell, cell, SECTION]
    place = tuple(at.astype(np.int64).T)
    filled = np.zeros([int(index.max()) + 1 for index in place], bool)
    filled[place] = True
    within = np.zeros((3, 3, 3), bool)
    within[:, :, 1] = True
    names, _ = label(filled, within)
    _, part = np.unique(names[place], return_inverse=True)
    of_part = np.bincount(part)
    of_section = np.bincount(place[2])
    return np.asarray(of_part[part] >= SHARE * of_section[place[2]])
