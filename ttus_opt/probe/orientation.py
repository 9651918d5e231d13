"""Which side of every face of a probe mesh is outside, and which faces can touch.

Meshes in files are often neither closed nor consistently wound, so the winding only
carries a decision from a face to its neighbours. The decision itself is a vote of rays:
random rays are followed to infinity from random points on both sides of a face. From
outside, a ray crosses the surface an even number of times, often none; from inside, an
odd number. Holes spoil a minority of rays.

A probe's mesh is often its housing, whose walls also have an inner face. Inner faces
cannot touch a patient and would push the other way; they are recognised by
`FaceOrientation.exposure`, the cosine-weighted fraction of the sky that a face sees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.compiled import compiled
from ttus_opt.core.errors import GeometryError
from ttus_opt.probe.mesh import TriangleMesh
from ttus_opt.probe.ray_casting import RayTree, count_crossings

#: Rays for the whole mesh, and limits of the rays per side of a face
TOTAL_RAYS, LEAST_RAYS, MOST_RAYS = 400_000, 16, 256

#: Of a finer mesh not every face votes, but one for each patch, cell and octant of
#: normals, and at most so many
FINE_MESH, MOST_VOTERS = 30_000, 12_000

#: Cells per voter at first, and by how much they grow while there are too many
CELLS, GROWTH = 0.5, 1.2

#: Exposures in this range are measured again with `CAREFUL_RAYS` rays: sixteen do not
#: distinguish a recess from an inner wall near an opening
DOUBTFUL, CAREFUL_RAYS = (0.1, 0.5), 64


#: Share of the opening that the largest hole has
MOST_OF_IT = 0.5
#: Least square of an opening's area that is divided by [m⁴]
TINY = 1e-30


@dataclass(frozen=True)
class FaceOrientation:
    """The result of the vote.

    Attributes:
        flip: Faces whose winding must be reversed to point outwards, (k,).
        exposure: Fraction of the sky seen by the outer side, cosine-weighted, 0 to 1,
            shape (k,) [–].
        patch: Number of the patch whose faces are decided together, shape (k,) [–].
    """

    flip: NDArray[np.bool_]
    exposure: Array
    patch: IntArray


def orient_faces(mesh: TriangleMesh, rng: np.random.Generator) -> FaceOrientation:
    """Find the outside of every face of a cleaned mesh.

    Raises:
        GeometryError: Most of the surface has no inside, like a flat plate.
    """
    tree = RayTree.build(mesh.corners)
    flip_in_patch, patch = consistent_patches(mesh)
    voters, group = _voters(mesh, flip_in_patch, patch)
    n_rays = int(np.clip(TOTAL_RAYS // len(mesh.faces), LEAST_RAYS, MOST_RAYS))
    even, escaped = _side_statistics(mesh, tree, voters, n_rays, rng)
    # those of a group are wound as their voter, or the other way round
    turned = flip_in_patch ^ flip_in_patch[voters][group]
    even, escaped = (
        np.where(turned[:, None], of_voter[group][:, ::-1], of_voter[group])
        for of_voter in (even, escaped)
    )
    vote = even[:, 0] - even[:, 1] + escaped[:, 0] - escaped[:, 1]
    sign = np.where(flip_in_patch, -1.0, 1.0)
    total = np.bincount(patch, weights=sign * vote * mesh.areas)
    area = np.bincount(patch, weights=mesh.areas)
    undecided = np.abs(total) <= 0.02 * area
    if area[undecided].sum() > 0.5 * mesh.area:
        raise GeometryError(
            "the mesh has no inside (rays escape equally on both sides): a flat or "
            "open sheet, close it or use surface='hull'"
        )
    flip = flip_in_patch ^ (total < 0)[patch]
    exposure = np.where(flip, escaped[:, 1], escaped[:, 0])
    if n_rays < CAREFUL_RAYS:
        own = exposure[voters]
        which = np.flatnonzero((own > DOUBTFUL[0]) & (own < DOUBTFUL[1]))
        doubtful = voters[which]
        outward = mesh.flipped(flip)
        _, again = _side_statistics(
            outward, tree, doubtful, CAREFUL_RAYS, rng, outer_only=True
        )
        own[which] = again[:, 0]
        exposure = own[group]
    return FaceOrientation(flip, exposure, patch)


def _voters(
    mesh: TriangleMesh, flip_in_patch: NDArray[np.bool_], patch: IntArray
) -> tuple[IntArray, IntArray]:
    """Faces that vote, and which of them votes for each face, shapes (v,) and (k,).

    All of them, or the largest of each group: of one patch, in one cell, with normals
    of one octant.
    """
    k = len(mesh.faces)
    if k <= FINE_MESH:
        return np.arange(k), np.arange(k)
    normal = np.where(flip_in_patch[:, None], -mesh.vector_areas, mesh.vector_areas)
    octant = (normal > 0.0) @ np.array([1, 2, 4])
    middle = mesh.corners.mean(axis=1)
    middle -= middle.min(axis=0)
    edge = float(np.sqrt(mesh.area / (CELLS * MOST_VOTERS)))
    by_size = np.argsort(-mesh.areas, kind="stable")
    while True:
        cell = (middle / edge).astype(np.int64)
        sizes = cell.max(axis=0) + 1
        key = np.ravel_multi_index(tuple(cell.T), tuple(sizes))
        key = (key * 8 + octant) * (int(patch.max()) + 1) + patch
        _, first, group = np.unique(
            key[by_size], return_index=True, return_inverse=True
        )
        if len(first) <= MOST_VOTERS or edge > mesh.extent:
            break
        edge *= GROWTH
    of_face = np.empty(k, np.int64)
    of_face[by_size] = group.reshape(-1)
    return by_size[first].astype(np.int64), of_face


def _side_statistics(
    mesh: TriangleMesh,
    tree: RayTree,
    which: IntArray,
    n_rays: int,
    rng: np.random.Generator,
    *,
    outer_only: bool = False,
) -> tuple[Array, Array]:
    """Fraction of even and of free rays on each side of some faces, (k, 2) each.

    Free rays of the side of their winding alone take a fraction of the time.
    """
    # One low-discrepancy set in the 4-cube (Roberts' additive recurrence; two numbers
    # for the origin in the face, two for the direction), shifted for every face.
    ratio = 1.1673039782614187  # positive root of x⁵ = x + 1
    lattice = np.arange(1, n_rays + 1)[:, None] * ratio ** -np.arange(1.0, 5.0) % 1.0
    even, free = _vote(
        mesh.corners,
        which,
        lattice,
        rng.random((len(which), 2, 4)),
        1e-7 * mesh.extent,
        tree,
        outer_only,
    )
    return np.asarray(even), np.asarray(free)


@compiled()
def _vote(
    corners: Array,
    which: IntArray,
    lattice: Array,
    shift: Array,
    lift: float,
    tree: RayTree,
    outer_only: bool,
) -> tuple[Array, Array]:
    """Cast the rays in the face's frame, so that they move with the mesh."""
    n_rays = len(lattice)
    even, free = np.zeros((len(which), 2)), np.zeros((len(which), 2))
    for j in range(len(which)):
        f = which[j]
        c = corners[f]
        first = c[1] - c[0]
        first = first / np.sqrt((first * first).sum())
        normal = np.cross(c[1] - c[0], c[2] - c[0])
        normal = normal / np.sqrt((normal * normal).sum())
        second = np.cross(normal, first)
        for side in range(1 if outer_only else 2):
            outward = normal if side == 0 else -normal
            for i in range(n_rays):
                u = (lattice[i] + shift[j, side]) % 1.0
                root = np.sqrt(u[0])  # uniform in the triangle
                origin = (
                    (1.0 - root) * c[0]
                    + root * (1.0 - u[1]) * c[1]
                    + root * u[1] * c[2]
                    + lift * outward
                )
                angle = 2.0 * np.pi * u[2]
                radius = np.sqrt(u[3])  # cosine-weighted over the half space
                direction = (
                    radius * np.cos(angle) * first
                    + radius * np.sin(angle) * second
                    + np.sqrt(1.0 - u[3]) * outward
                )
                n = count_crossings(origin, direction, f, tree, outer_only)
                if n % 2 == 0:
                    even[j, side] += 1.0 / n_rays
                if n == 0:
                    free[j, side] += 1.0 / n_rays
    return even, free


def _edges(mesh: TriangleMesh, faces: int) -> tuple[IntArray, IntArray, IntArray]:
    """First and second vertex of every face's edges, and edges of so many faces.

    Each has its ``faces`` numbers among the 3k in a row, shape (n, faces).
    """
    start = mesh.faces.reshape(-1)
    end = np.roll(mesh.faces, -1, axis=1).reshape(-1)
    key = np.minimum(start, end) * len(mesh.vertices) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    _, begin, count = np.unique(key[order], return_index=True, return_counts=True)
    return start, end, order[begin[count == faces][:, None] + np.arange(faces)]


def consistent_patches(mesh: TriangleMesh) -> tuple[NDArray[np.bool_], IntArray]:
    """Join faces across edges of exactly two faces into consistently wound patches.

    Returns:
        Whether a face must be reversed to agree with its patch's first face, (k,), and
        the number of its patch, (k,). Faces of a patch that cannot be wound
        consistently (a Möbius strip) are patches of their own.
    """
    k = len(mesh.faces)
    start, _, edges = _edges(mesh, 2)
    a, b = edges.T
    first, second = a // 3, b // 3
    # Each face has two copies, original (f) and reversed (f + k); an edge joins the
    # copies that agree. A patch is consistent when its two copies are not connected.
    # Faces of equal winding traverse their common edge in opposite directions.
    turned = np.where(start[a] != start[b], 0, k)
    rows = np.concatenate([first, first + k])
    columns = np.concatenate([second + turned, second + k - turned])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), (2 * k, 2 * k))
    _, label = connected_components(graph, directed=False)
    straight, turned = label[:k].astype(np.int64), label[k:].astype(np.int64)
    lone = straight == turned
    patch = np.minimum(straight, turned)
    patch[lone] = 2 * k + np.flatnonzero(lone)
    _, patch = np.unique(patch, return_inverse=True)
    return (straight > turned) & ~lone, patch.reshape(-1).astype(np.int64)


def largest_hole(mesh: TriangleMesh) -> Array | None:
    """Middle of the hole that leaves a mesh open, shape (3,) [m].

    None without holes, or where many small ones add up to it.

    The vector areas of all holes add up to that of the mesh; the hole is the one that
    contributes most.

    Args:
        mesh: Consistently wound, welded.
    """
    start, end, edges = _edges(mesh, 1)
    if not len(edges):
        return None
    a, b = start[edges[:, 0]], end[edges[:, 0]]
    shape = len(mesh.vertices), len(mesh.vertices)
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape)
    _, label = connected_components(graph, directed=False)
    loop = label[a]
    first, second = mesh.vertices[a], mesh.vertices[b]
    # a loop's vector area is that of any surface that closes it
    vectors = 0.5 * np.cross(first, second)
    area = np.stack([np.bincount(loop, weights=v) for v in vectors.T], axis=1)
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
