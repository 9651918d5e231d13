"""The holes of a mesh: loops of edges that belong to one face only."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ttus_opt.core.arrays import Array
from ttus_opt.probe.mesh import TriangleMesh

#: Share of the opening that the largest hole has
MOST_OF_IT = 0.5

#: Least square of an opening's area that is divided by [m⁴]
TINY = 1e-30


def largest_hole(mesh: TriangleMesh) -> Array | None:
    """Middle of the hole that leaves a mesh open, shape (3,) [m].

    None without holes, or where many small ones add up to it.

    The vector areas of all holes add up to that of the mesh; the hole is the one that
    contributes most.

    Args:
        mesh: Consistently wound, welded.
    """
    n = len(mesh.vertices)
    start = mesh.faces.reshape(-1)
    end = np.roll(mesh.faces, -1, axis=1).reshape(-1)
    key = np.minimum(start, end) * n + np.maximum(start, end)
    _, place, count = np.unique(key, return_index=True, return_counts=True)
    edges = place[count == 1]
    if not len(edges):
        return None
    a, b = start[edges], end[edges]
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), (n, n))
    _, label = connected_components(graph, directed=False)
    loop = label[a]
    first, second = mesh.vertices[a], mesh.vertices[b]
    # a loop's vector area is that of any surface that closes it
    area = _sums(loop, 0.5 * np.cross(first, second))
    share = (
        area @ area.sum(axis=0) / max(float(area.sum(axis=0) @ area.sum(axis=0)), TINY)
    )
    largest = int(np.argmax(share))
    if share[largest] < MOST_OF_IT:
        return None
    own = loop == largest
    length = np.linalg.norm(second - first, axis=1)[own]
    middle = 0.5 * (first + second)[own]
    return np.asarray(length @ middle / length.sum())


def _sums(label: Array, vectors: Array) -> Array:
    return np.stack([np.bincount(label, weights=v) for v in vectors.T], axis=1)
