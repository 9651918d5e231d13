import numba
import numpy as np
import pytest
import trimesh

from ttus_opt.probe.ray_casting import RayTree, count_crossings


@numba.njit
def crossings(tree, origins, directions):
    """How many faces each of some rays crosses."""
    out = np.empty(len(origins), np.int64)
    for n in range(len(origins)):
        out[n] = count_crossings(origins[n], directions[n], -1, tree)
    return out


def brute_force(corners, origins, directions):
    """Crossings by solving the 3 × 3 system of every ray with every face."""
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    counts = []
    for origin, direction in zip(origins, directions, strict=True):
        minus = np.broadcast_to(-direction, edge_1.shape)
        system = np.stack([edge_1, edge_2, minus], axis=2)
        a, b, t = np.linalg.solve(system, (origin - corners[:, 0])[..., None])[..., 0].T
        counts.append(((a >= 0) & (b >= 0) & (a + b <= 1) & (t > 0)).sum())
    return np.array(counts)


@pytest.mark.slow
def test_counts_equal_brute_force_on_a_soup():
    rng = np.random.default_rng(4)
    corners = rng.normal(size=(300, 1, 3)) + 0.3 * rng.normal(size=(300, 3, 3))
    origins, directions = rng.normal(size=(2, 400, 3))
    counts = crossings(RayTree.build(corners), origins, directions)
    np.testing.assert_array_equal(counts, brute_force(corners, origins, directions))
    assert counts.max() >= 4


def test_parity_tells_inside_of_a_sphere():
    sphere = trimesh.creation.icosphere(subdivisions=3)
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.2, 1.2, (2000, 3))
    radius = np.linalg.norm(points, axis=1)
    points = points[np.abs(radius - 1) > 0.02]
    inside = np.linalg.norm(points, axis=1) < 1
    tree = RayTree.build(np.asarray(sphere.triangles))
    counts = crossings(tree, points, rng.normal(size=points.shape))
    np.testing.assert_array_equal(counts % 2 == 1, inside)


def test_rays_along_the_axes_pass_flat_boxes():
    box = np.asarray(trimesh.creation.box((2, 2, 2)).triangles)
    origins = np.array([[0.1, 0.2, 0.3], [0.1, 0.2, 5.0], [0.1, 0.2, -5.0]])
    directions = np.tile([0.0, 0.0, 1.0], (3, 1))
    counts = crossings(RayTree.build(box), origins, directions)
    np.testing.assert_array_equal(counts, [1, 0, 2])


def test_a_single_face():
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    tree = RayTree.build(corners)
    counts = crossings(
        tree, np.array([[0.2, 0.2, 1.0]] * 2), np.array([[0, 0, -1.0], [0, 0, 1]])
    )
    np.testing.assert_array_equal(counts, [1, 0])
