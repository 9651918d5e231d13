"""How often a ray crosses a triangle mesh: a bounding-volume hierarchy, compiled.

Written here because the orientation vote casts a million rays, which are generated
inside the kernel instead of being stored.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.compiled import compiled

LEAF = 4  # faces per leaf


class RayTree(NamedTuple):
    """A binary tree of boxes over triangles, as flat arrays for kernels.

    Attributes:
        corner: First corner of every face in tree order, shape (k, 3) [m].
        edges: The two edges from it, shape (k, 2, 3) [m].
        face: Index of that face in the mesh, shape (k,) [–].
        boxes: Lower and upper corner of every node, shape (n, 6) [m].
        children: Of an inner node its children; of a leaf (−1 − begin, end) of its
            faces; shape (n, 2) [–].
    """

    corner: Array
    edges: Array
    face: IntArray
    boxes: Array
    children: IntArray

    @classmethod
    def build(cls, corners: Array) -> RayTree:
        """The tree over triangles with corner points (k, 3, 3) [m]."""
        order, boxes, children = _build(
            corners.min(axis=1), corners.max(axis=1), corners.mean(axis=1)
        )
        sorted_corners = corners[order]
        return cls(
            np.ascontiguousarray(sorted_corners[:, 0]),
            np.ascontiguousarray(sorted_corners[:, 1:] - sorted_corners[:, :1]),
            order,
            boxes,
            children,
        )


@compiled()
def _build(
    lower: Array, upper: Array, centre: Array
) -> tuple[IntArray, Array, IntArray]:
    """Median split along the longest side of the centres' box."""
    k = len(centre)
    order = np.arange(k)
    boxes = np.empty((2 * k, 6))
    children = np.empty((2 * k, 2), np.int64)
    stack = [(0, 0, k)]
    used = 1
    while len(stack) > 0:
        node, begin, end = stack.pop()
        low = np.full(3, np.inf)
        high = np.full(3, -np.inf)
        c_low = np.full(3, np.inf)
        c_high = np.full(3, -np.inf)
        for m in range(begin, end):
            f = order[m]
            for d in range(3):
                low[d] = min(low[d], lower[f, d])
                high[d] = max(high[d], upper[f, d])
                c_low[d] = min(c_low[d], centre[f, d])
                c_high[d] = max(c_high[d], centre[f, d])
        boxes[node, :3] = low
        boxes[node, 3:] = high
        if end - begin <= LEAF:
            children[node, 0] = -1 - begin
            children[node, 1] = end
            continue
        axis = np.argmax(c_high - c_low)
        part = order[begin:end].copy()
        order[begin:end] = part[np.argsort(centre[part, axis])]
        middle = (begin + end) // 2
        children[node, 0] = used
        children[node, 1] = used + 1
        stack.append((used, begin, middle))
        stack.append((used + 1, middle, end))
        used += 2
    return order, boxes[:used].copy(), children[:used].copy()


@compiled()
def count_crossings(
    origin: Array,
    direction: Array,
    skip: int,
    tree: RayTree,
    first_only: bool = False,
) -> int:
    """Faces one ray crosses, all but face ``skip``, or any of them (compiled)."""
    corner, edges, face, boxes, children = tree
    ox, oy, oz = origin[0], origin[1], origin[2]
    dx, dy, dz = direction[0], direction[1], direction[2]
    tiny = 1e-300
    ix = 1.0 / (dx if abs(dx) > tiny else tiny)
    iy = 1.0 / (dy if abs(dy) > tiny else tiny)
    iz = 1.0 / (dz if abs(dz) > tiny else tiny)
    stack = np.empty(64, np.int64)  # the tree is balanced: depth = log2(faces)
    stack[0] = 0
    top = 1
    count = 0
    while top > 0 and not (first_only and count > 0):
        top -= 1
        n = stack[top]
        t0 = (boxes[n, 0] - ox) * ix
        t1 = (boxes[n, 3] - ox) * ix
        near, far = min(t0, t1), max(t0, t1)
        t0 = (boxes[n, 1] - oy) * iy
        t1 = (boxes[n, 4] - oy) * iy
        near, far = max(near, min(t0, t1)), min(far, max(t0, t1))
        t0 = (boxes[n, 2] - oz) * iz
        t1 = (boxes[n, 5] - oz) * iz
        near, far = max(near, min(t0, t1)), min(far, max(t0, t1))
        # a flat box's slabs may miss by rounding: leave a little room
        if far < 0.0 or near > far + 1e-12 * abs(far):
            continue
        if children[n, 0] >= 0:
            stack[top] = children[n, 0]
            stack[top + 1] = children[n, 1]
            top += 2
            continue
        for m in range(-1 - children[n, 0], children[n, 1]):
            if face[m] == skip:
                continue
            # Möller-Trumbore
            ux, uy, uz = edges[m, 0, 0], edges[m, 0, 1], edges[m, 0, 2]
            vx, vy, vz = edges[m, 1, 0], edges[m, 1, 1], edges[m, 1, 2]
            px, py, pz = dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx
            det = ux * px + uy * py + uz * pz
            if det == 0.0:
                continue
            sx, sy, sz = ox - corner[m, 0], oy - corner[m, 1], oz - corner[m, 2]
            a = (sx * px + sy * py + sz * pz) / det
            if a < 0.0 or a > 1.0:
                continue
            qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
            b = (dx * qx + dy * qy + dz * qz) / det
            if b < 0.0 or a + b > 1.0:
                continue
            if (vx * qx + vy * qy + vz * qz) / det > 0.0:
                count += 1
    return count
