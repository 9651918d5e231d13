from dataclasses import dataclass

import numba
import numpy as np
import pytest
import trimesh

from tests.kit import SHARED, GeometryError, refuses
from ttus_opt.probe import orientation
from ttus_opt.probe.mesh import TriangleMesh, read_mesh
from ttus_opt.probe.orientation import consistent_patches, orient_faces

PROBE = SHARED / "probe" / "Probe_L14-5_38_lowres.stl"


def torus():
    return trimesh.creation.torus(0.03, 0.01, major_sections=20, minor_sections=10)


def capsule():
    return trimesh.creation.capsule(height=0.05, radius=0.015, count=[12, 12])


def box():
    return trimesh.creation.box((0.05, 0.02, 0.01))


def probe_head():
    """A linear probe's outline with concave shoulders, extruded."""
    outline = [[-20, 0], [20, 0], [20, 12], [9, 22], [9, 70], [-9, 70], [-9, 22]]
    outline.append([-20, 12])
    n = len(outline)
    bottom = np.column_stack([outline, np.zeros(n)]) * 1e-3
    vertices = np.vstack([bottom, bottom + np.array([0, 0, 0.012])])
    # the cap as two convex parts, then the walls
    cap = [[0, 1, 2], [0, 2, 7], [7, 2, 3], [7, 3, 6], [6, 3, 4], [6, 4, 5]]
    faces = [f[::-1] for f in cap] + [[a + n for a in f] for f in cap]
    for i in range(n):
        j = (i + 1) % n
        faces += [[i, j, j + n], [i, j + n, i + n]]
    return trimesh.Trimesh(vertices, faces, process=False)


SHAPES = [torus, capsule, box, probe_head]


def as_mesh(shape):
    made = shape()
    assert made.is_watertight and made.is_winding_consistent and made.volume > 0
    return TriangleMesh(np.array(made.vertices), np.array(made.faces, dtype=np.int64))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", [0, 1])
def test_randomly_turned_faces_all_come_back(shape, seed):
    mesh = as_mesh(shape)
    turned = np.random.default_rng(seed).random(len(mesh.faces)) < 0.5
    found = orient_faces(mesh.flipped(turned), np.random.default_rng(seed))
    np.testing.assert_array_equal(found.flip, turned)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", [0, 1])
def test_holes_and_turned_faces_together(shape, seed):
    mesh = as_mesh(shape)
    rng = np.random.default_rng(seed)
    kept = rng.random(len(mesh.faces)) < 0.9
    kept[rng.integers(len(kept))] = False  # never by chance a closed mesh
    turned = rng.random(len(mesh.faces)) < 0.5
    damaged = mesh.flipped(turned).subset(kept)
    found = orient_faces(damaged, rng)
    np.testing.assert_array_equal(found.flip, turned[kept])


@pytest.mark.parametrize("shape", SHAPES)
def test_a_soup_without_shared_vertices_is_decided_face_by_face(shape):
    mesh = as_mesh(shape)
    turned = np.random.default_rng(5).random(len(mesh.faces)) < 0.5
    flipped = mesh.flipped(turned)
    k = len(mesh.faces)
    soup = TriangleMesh(flipped.corners.reshape(-1, 3), np.arange(3 * k).reshape(k, 3))
    found = orient_faces(soup, np.random.default_rng(0))
    assert len(np.unique(found.patch)) == k
    np.testing.assert_array_equal(found.flip, turned)


def test_walls_of_a_housing_point_into_the_wall_and_the_inner_ones_are_hidden():
    outer, inner = box(), trimesh.creation.box((0.046, 0.016, 0.006))
    vertices = np.vstack([outer.vertices, inner.vertices])
    faces = np.vstack([outer.faces, inner.faces[:, ::-1] + 8])  # outwards = into air
    found = orient_faces(TriangleMesh(vertices, faces), np.random.default_rng(0))
    assert not found.flip.any()
    assert found.exposure[:12].min() > 0.99
    assert found.exposure[12:].max() == 0.0


@dataclass(frozen=True)
class Groove:
    """A long groove of width and depth w: its floor sees √2 − 1 of the sky."""

    mesh: TriangleMesh
    floor: np.ndarray


def groove():
    w, long = 0.01, 2.0
    made = trimesh.creation.extrude_triangulation(
        np.array(
            [
                [0, 0],
                [3, 0],
                [3, 1],
                [2, 1],
                [1, 1],
                [0, 1],
                [3, 2],
                [2, 2],
                [1, 2],
                [0, 2],
            ]
        )
        * w,
        np.array(
            [
                [0, 1, 2],
                [0, 2, 3],
                [0, 3, 4],
                [0, 4, 5],
                [3, 2, 6],
                [3, 6, 7],
                [5, 4, 8],
                [5, 8, 9],
            ]
        ),
        height=long,
    )
    mesh = TriangleMesh(np.array(made.vertices), np.array(made.faces)).cleaned()
    flat = np.ptp(mesh.corners[:, :, 1], axis=1) < 1e-6
    centre = mesh.corners.mean(axis=1)
    floor = flat & (np.abs(centre[:, 1] - w) < 1e-6)
    floor &= (centre[:, 0] > w) & (centre[:, 0] < 2 * w)
    assert floor.sum() == 2
    return Groove(mesh, floor)


def test_exposure_of_a_groove_equals_its_view_factor():
    made = groove()
    found = orient_faces(made.mesh, np.random.default_rng(0))
    assert found.exposure[made.floor].mean() == pytest.approx(np.sqrt(2) - 1, abs=0.03)


def test_a_doubtful_face_is_measured_again_with_more_rays(monkeypatch):
    """As on a mesh of many faces, which have sixteen rays each."""
    made = groove()
    monkeypatch.setattr(orientation, "TOTAL_RAYS", 0)
    found = np.array(
        [
            orient_faces(made.mesh, np.random.default_rng(seed)).exposure[made.floor]
            for seed in range(8)
        ]
    )
    hits = found * orientation.CAREFUL_RAYS
    np.testing.assert_allclose(hits, hits.round(), atol=1e-9)
    assert (hits.round() % 4 > 0).any()  # sixteen rays would give quarters of it
    assert found.mean() == pytest.approx(np.sqrt(2) - 1, abs=0.04)


def test_walls_modelled_twice_are_decided_by_the_rays_that_escape():
    """Every ray crosses such walls an even number of times, from either side."""
    made = box()
    twice = TriangleMesh(
        np.vstack([made.vertices] * 2), np.vstack([made.faces, made.faces + 8])
    )
    turned = np.random.default_rng(1).random(24) < 0.5
    found = orient_faces(twice.flipped(turned), np.random.default_rng(0))
    np.testing.assert_array_equal(found.flip, turned)


def test_a_moebius_strip_is_not_one_patch():
    turn = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    radial = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    across = np.cos(turn / 2)[:, None] * radial + np.sin(turn / 2)[:, None] * [0, 0, 1]
    vertices = np.vstack([radial - 0.3 * across, radial + 0.3 * across])
    faces = []
    for i in range(20):
        j, k = (i + 1, i + 21) if i < 19 else (20, 0)  # the last joins upside down
        faces += [[i, j, k], [i, k, i + 20]]
    _, patch = consistent_patches(TriangleMesh(vertices, np.array(faces)))
    assert len(np.unique(patch)) == 40


def test_a_flat_plate_has_no_inside():
    vertices = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]])
    plate = TriangleMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    refuses(GeometryError, "no inside", orient_faces, plate, np.random.default_rng(0))


@numba.njit
def winding_numbers(points, corners):
    """Generalised winding number by solid angles (van Oosterom and Strackee)."""
    out = np.zeros(len(points))
    for i in range(len(points)):
        for f in range(len(corners)):
            a, b = corners[f, 0] - points[i], corners[f, 1] - points[i]
            c = corners[f, 2] - points[i]
            la, lb = np.sqrt((a * a).sum()), np.sqrt((b * b).sum())
            lc = np.sqrt((c * c).sum())
            top = (a * np.cross(b, c)).sum()
            bottom = la * lb * lc + (a * b).sum() * lc + (b * c).sum() * la
            out[i] += np.arctan2(top, bottom + (c * a).sum() * lb) / (2 * np.pi)
    return out


@pytest.mark.slow
@pytest.mark.skipif(not PROBE.exists(), reason="shared probe mesh is not here")
def test_real_probe_agrees_with_the_winding_number():
    mesh = read_mesh(PROBE, unit="mm")
    rng = np.random.default_rng(0)
    found = orient_faces(mesh, rng)
    outward = mesh.flipped(found.flip).vector_areas / mesh.areas[:, None]
    outer = np.flatnonzero(found.exposure > 1 / 3)
    weight = mesh.areas[outer] / mesh.areas[outer].sum()
    pick = rng.choice(outer, 100, p=weight)
    centre = mesh.corners[pick].mean(axis=1)
    # by the file's own winding, which the vote takes no side from
    above = winding_numbers(centre + 1e-5 * outward[pick], mesh.corners)
    below = winding_numbers(centre - 1e-5 * outward[pick], mesh.corners)
    assert (below - above < 0.5).mean() <= 0.01


@pytest.mark.parametrize("corner", range(3))
def test_rays_start_all_over_a_face(corner):
    """A shield close above one corner stops as large a share as it covers."""
    face = 0.01 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    shield = face[corner] + 0.4 * (face - face[corner]) + [0.0, 0.0, 1e-5]
    mesh = TriangleMesh(np.vstack([face, shield]), np.array([[0, 1, 2], [3, 4, 5]]))
    tree = orientation.RayTree.build(mesh.corners)
    even, free = orientation._side_statistics(
        mesh, tree, np.array([0]), 2000, np.random.default_rng(0)
    )
    covered = 0.4**2
    np.testing.assert_allclose(free, [[1.0 - covered, 1.0]], atol=0.01)
    np.testing.assert_allclose(even, free)  # each that is stopped crosses once
