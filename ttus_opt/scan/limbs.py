"""Arms beside a trunk, told by the gap that sections show between them.

In each section across the axis, what does not hang together with the rest, has less
than `SHARE` of its points and is no wider than an arm is a limb. Legs have half each,
and stay; so does a part of the trunk behind a fold, which is wide.
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

#: Largest extent of a limb's section [m]
WIDTH = 0.16


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
    low = np.full((len(of_part), 2), np.inf)
    high = -low
    np.minimum.at(low, part, points[:, :2])
    np.maximum.at(high, part, points[:, :2])
    wide = (high - low).max(axis=1) > WIDTH
    return np.asarray(wide[part] | (of_part[part] >= SHARE * of_section[place[2]]))
