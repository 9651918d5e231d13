import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from tests.kit import InputError, refuses
from ttus_opt.probe.even_sampling import (
    SurfaceSamples,
    dense_samples,
    match_moments,
    spread_evenly,
)
from ttus_opt.probe.mesh import TriangleMesh


def sphere_mesh():
    made = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
    return TriangleMesh(np.array(made.vertices), np.array(made.faces, dtype=np.int64))


def variation(points):
    """Coefficient of variation of the distance to the nearest neighbour."""
    distance = KDTree(points).query(points, k=2)[0][:, 1]
    return distance.std() / distance.mean()


def test_dense_samples_are_stratified_by_area():
    mesh = TriangleMesh(
        np.array([[0.0, 0, 0], [3, 0, 0], [0, 1, 0], [0, -2, 0]]) * 0.01,
        np.array([[0, 1, 2], [0, 3, 1]]),
    )
    dense = dense_samples(mesh, 3000, np.random.default_rng(0))
    assert abs(int((dense.points[:, 1] > 0).sum()) - 1000) <= 1
    assert dense.areas.sum() == pytest.approx(mesh.area, rel=1e-12)
    upper = dense.points[dense.points[:, 1] > 0]
    np.testing.assert_allclose(upper.mean(axis=0), [0.01, 0.01 / 3, 0], atol=4e-4)


def test_evenness_against_random_sampling():
    mesh = sphere_mesh()
    dense = dense_samples(mesh, 64 * 600, np.random.default_rng(0))
    even = spread_evenly(dense, 600)
    assert variation(dense.points[:600]) > 0.45
    assert variation(even.points) < 0.16
    assert even.areas.sum() == pytest.approx(mesh.area, rel=1e-12)
    assert even.areas.std() / even.areas.mean() < 0.2
    radial = even.points / np.linalg.norm(even.points, axis=1, keepdims=True)
    assert (radial * even.normals).sum(axis=1).min() > np.cos(np.radians(4))


def test_a_thin_wall_has_its_two_sides_sampled_apart():
    made = trimesh.creation.box((0.05, 0.05, 0.0005))
    mesh = TriangleMesh(np.array(made.vertices), np.array(made.faces, dtype=np.int64))
    even = spread_evenly(dense_samples(mesh, 64 * 400, np.random.default_rng(0)), 400)
    for side in (1.0, -1.0):
        here = even.normals[:, 2] * side > 0.9
        assert even.areas[here].sum() == pytest.approx(25e-4, rel=0.02)
        assert variation(even.points[here]) < 0.2
        # at the rim, 0.5 mm high, normals may lean; elsewhere they are the wall's
        inner = here & (np.abs(even.points[:, :2]).max(axis=1) < 0.02)
        assert inner.sum() > 100
        np.testing.assert_allclose(even.normals[inner], [[0, 0, side]] * inner.sum())


def test_points_are_samples_and_distinct():
    dense = dense_samples(sphere_mesh(), 64 * 50, np.random.default_rng(3))
    even = spread_evenly(dense, 50)
    assert KDTree(dense.points).query(even.points)[0].max() == 0.0
    assert len(np.unique(even.points, axis=0)) == 50


@pytest.mark.parametrize("n_points", [0, 3, 101])
def test_counts_that_cannot_be(n_points):
    dense = dense_samples(sphere_mesh(), 100, np.random.default_rng(0))
    refuses(InputError, "between 4 and 100", spread_evenly, dense, n_points)


def test_moments_are_matched_with_little_change():
    made = trimesh.creation.box((0.05, 0.02, 0.01))
    mesh = TriangleMesh(np.array(made.vertices), np.array(made.faces, dtype=np.int64))
    even = spread_evenly(dense_samples(mesh, 64 * 300, np.random.default_rng(1)), 300)
    net, moment = mesh.area * np.array([[0.01, 0, 0], [0, 2e-4, 0]])
    out = match_moments(even, mesh.area, net, moment)
    np.testing.assert_allclose(out.areas.sum(), mesh.area, rtol=1e-12)
    np.testing.assert_allclose(out.areas @ out.normals, net, atol=1e-12 * mesh.area)
    np.testing.assert_allclose(out.areas @ out.points, moment, atol=1e-14 * mesh.area)
    assert np.abs(out.areas / even.areas - 1).max() < 0.2


def test_few_points_keep_the_total_area_only():
    normals = np.eye(3)[[0, 1, 2, 0]]
    few = SurfaceSamples(0.01 * normals, normals, np.array([1.0, 2, 3, 4]))
    out = match_moments(few, 20.0, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(out.areas, [2, 4, 6, 8])
