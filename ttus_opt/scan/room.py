"""The body in the scan of a room, where it stands alone.

Floor, walls and table tops are planes: the large ones are taken away. Of what is left,
a body is the part of a body's size that has no other like it. The table that it lies on
comes with it, because the patient's frame is found by it.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.scan.supporting_plane import (
    find_supporting_plane,
    planes_through,
    refined_plane,
)

#: Larger scans are of a room [m], larger ones in another unit
ROOM, LARGEST_ROOM = 2.2, 10.0

#: Edge of the cells that hang together where they touch [m]
CELL = 0.05

#: A plane has this share of the cells, and its cells lie this close [–, m]
PLANE_SHARE, PLANE_DISTANCE, MOST_PLANES = 0.06, 0.06, 8

#: A plane reaches this far in two directions [m]; a body is not flat and as long
PLANE_WIDTH = 0.8

#: Length of a body [m]; the next part is smaller than this share of it [–]
LENGTHS, ALONE = (0.35, 2.2), 0.5

#: A part as flat and as wide as this is a strip of floor or wall (standard deviations)
#: [m]; the front half of a trunk has about 0.025 and 0.1
FLAT, BROAD = 0.015, 0.12

#: Around a body this much of its table is kept; a body lies on a plane when its lowest
#: points are this close and its highest not further than this [m]
MARGIN, LYING = 0.3, (0.12, 0.6)


def alone_in_room(points: Array) -> Mask:
    """Which points of a room are the body that stands alone, and its table, shape (n,).

    Args:
        points: Scan of a room, shape (n, 3) [m].

    Raises:
        GeometryError: No part has a body's size, or several do: their boxes are named.
    """
    from scipy.ndimage import label

    place = np.floor((points - points.min(axis=0)) / CELL).astype(np.int64)
    cells, cell_of = np.unique(place, axis=0, return_inverse=True)
    cell_of = cell_of.reshape(-1)
    centres = points.min(axis=0) + CELL * (cells + 0.5)
    left = ~_planes(centres)
    filled = np.zeros(cells.max(axis=0) + 1, bool)
    filled[tuple(cells[left].T)] = True
    names, n_parts = label(filled, np.ones((3, 3, 3), bool))
    part = np.where(left, names[tuple(cells.T)], 0)
    sizes = np.bincount(part, minlength=n_parts + 1)
    sizes[0] = 0
    boxes = {}
    for name in np.argsort(-sizes)[:20].tolist():
        own = centres[part == name] if sizes[name] else centres[:0]
        if len(own) <= 20 or not LENGTHS[0] < np.ptp(own, axis=0).max() < LENGTHS[1]:
            continue
        spread = np.linalg.eigvalsh(np.cov(points[part[cell_of] == name].T))
        if spread[0] > FLAT**2 or spread[1] < BROAD**2:
            boxes[name] = own.min(axis=0) - CELL, own.max(axis=0) + CELL
    first, *others = [*boxes] or [0]
    if not boxes:
        raise GeometryError(
            "the scan shows a room, and nothing of a body's size that stands apart "
            "from floor and walls: check its unit, or crop a room to the patient by "
            "box=xmin,xmax,ymin,ymax,zmin,zmax"
        )
    if others and sizes[others[0]] > ALONE * sizes[first]:
        told = "; or ".join(_box(*boxes[name]) for name in [first, *others][:3])
        raise GeometryError(f"the scan shows several bodies: crop it by box={told}")
    return _with_table(points, np.asarray(part[cell_of] == first))


def _with_table(points: Array, body: Mask) -> Mask:
    """The body's points (n,) and what is around it, where it lies on a plane."""
    low, high = points[body].min(axis=0), points[body].max(axis=0)
    around = ((points > low - MARGIN) & (points < high + MARGIN)).all(axis=1)
    try:
        plane = find_supporting_plane(points[around])
    except InputError:  # too few points for one
        return body
    if plane is None:
        return body
    lowest, highest = np.percentile(plane.height(points[body]), [2, 98])
    lies = lowest < LYING[0] and highest < LYING[1]
    return np.asarray(around & (plane.height(points) > -MARGIN)) if lies else body


def _box(low: Array, high: Array) -> str:
    return ",".join(f"{v:.2f}" for v in np.stack([low, high], axis=1).ravel())


def _planes(centres: Array) -> Mask:
    """Which cells (n, 3) [m] lie on a large plane, shape (n,)."""
    rng = np.random.default_rng(0)
    on = np.zeros(len(centres), bool)
    for _ in range(MOST_PLANES):
        rest = np.flatnonzero(~on)
        if len(rest) < 100:
            break
        some = centres[rng.choice(rest, min(3000, len(rest)), replace=False)]
        triples = centres[rest[rng.integers(len(rest), size=(3, 500))]]
        normals, offsets = planes_through(*triples)
        if not len(offsets):
            break
        near = np.abs(normals @ some.T - offsets[:, None]) < PLANE_DISTANCE
        best = int(near.sum(axis=1).argmax())
        normal, offset = refined_plane(
            centres[rest], normals[best], float(offsets[best]), PLANE_DISTANCE
        )
        found = rest[np.abs(centres[rest] @ normal - offset) < PLANE_DISTANCE]
        if len(found) < PLANE_SHARE * len(centres) or not _wide(centres[found]):
            break
        on[found] = True
    return on


def _wide(points: Array) -> bool:
    """Whether a plane's points reach far in two directions."""
    _, vectors = np.linalg.eigh(np.cov(points.T))
    spread = points @ vectors[:, 1:]
    width = np.ptp(np.percentile(spread, [5, 95], axis=0), axis=0)
    return bool(width.min() > PLANE_WIDTH)
