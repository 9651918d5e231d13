"""The skin's mesh, its cut, and rays against analytic bodies."""

import io

import numpy as np
import pytest
import trimesh

from tests.kit import torso
from ttus_opt.scan.surface import Surface
from ttus_opt.viewer.arrow import SECTIONS, _tube
from ttus_opt.viewer.looks import lit
from ttus_opt.viewer.skin import SkinMesh, place_on_ray


def test_nodes_lie_on_the_skin_and_faces_look_outwards():
    skin = SkinMesh.of(torso(), 0.012)
    radius = torso().radius_at(skin.theta, skin.z)
    np.testing.assert_allclose(np.hypot(*skin.vertices[:, :2].T), radius)
    a, b, c = (skin.vertices[skin.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    middle = (a + b + c) / 3.0
    assert (np.einsum("ki,ki->k", normal[:, :2], middle[:, :2]) > 0.0).all()
    assert np.linalg.norm(b - a, axis=1).max() < 0.03


def test_the_file_of_the_skin_is_read_by_another_program():
    skin = SkinMesh.of(torso())
    drawn = skin.cut(np.array([0.0, 0.0, 1.0]), 0.1)
    content = skin.glb(np.full((len(skin.z), 3), 0.5), drawn)
    mesh = trimesh.load_mesh(io.BytesIO(content), "glb", process=False)
    np.testing.assert_allclose(mesh.vertices, skin.vertices, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(mesh.faces, drawn)
    whole = trimesh.Trimesh(skin.vertices, skin.faces, process=False)
    off = np.linalg.norm(whole.vertex_normals - skin.normals, axis=1)
    inner = (skin.z > skin.z.min()) & (skin.z < skin.z.max())
    assert off[inner].max() < 0.005 and off.max() < 0.1
    assert mesh.visual.material.doubleSided


def test_light_is_what_a_rough_surface_sends():
    """Lambert's law, of an even light and two from the sides of the front."""
    grey, front = np.full((3, 3), 188, np.uint8), np.array([0.0, 1.0, 0.0])
    normals = np.array([front, -front, [1.0, 0.0, 0.0]])
    one = np.array([[0.7, 1.0, -0.5]]) / np.sqrt(0.49 + 1.0 + 0.25)
    cosines = np.array([2.0 * one[0, 1], 0.0, one[0, 0]])
    expected = 0.5 * 2.1 / np.pi * (1.0 + 0.35 * cosines)  # 188 is half of the light
    found = lit(grey, normals, front)
    np.testing.assert_allclose(found, np.tile(expected[:, None], 3), rtol=7e-3)


@pytest.mark.parametrize("high", [0.02, 0.0])
def test_a_tube_is_closed_and_looks_outwards(high):
    tube = _tube(0.02, high, 0.1)
    mesh = trimesh.Trimesh(tube.vertices, tube.faces)
    mesh.update_faces(mesh.nondegenerate_faces())  # a cone's ring at its tip
    sector = 0.5 * SECTIONS * np.sin(2.0 * np.pi / SECTIONS)
    share = 1.0 if high else 1.0 / 3.0
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(share * sector * 0.02**2 * 0.1)


def test_a_cut_leaves_what_lies_behind_the_plane():
    skin = SkinMesh.of(torso())
    left = skin.vertices[skin.cut(np.array([0.0, 0.0, 1.0]), 0.1)]
    assert left[:, :, 2].min(axis=1).max() <= 0.1
    assert left[:, :, 2].max() < 0.12
    assert len(skin.cut(np.array([0.0, 0.0, 1.0]), 9.0)) == len(skin.faces)
    end = np.nextafter(skin.z.min(), -1.0)  # a slider's end in mm is rounded
    assert len(skin.cut(np.array([0.0, 0.0, 1.0]), end)) > 0


def test_a_ray_meets_a_cylinder_where_geometry_says():
    cylinder = Surface.from_radius(np.full((360, 5), 0.1), np.linspace(0.0, 0.3, 5))
    # x = 0.3 − t, z = 0.1 + t/4, from the right: meets r = 0.1 at t = 0.2
    (theta, z), met = place_on_ray(
        cylinder, np.array([0.3, 0.0, 0.1]), np.array([-1.0, 0.0, 0.25])
    )
    assert met
    assert theta == pytest.approx(0.0, abs=1e-6)
    assert z == pytest.approx(0.15, abs=1e-5)
    # from the left the other side is met
    (theta, _), met = place_on_ray(
        cylinder, np.array([-0.3, 0.0, 0.1]), np.array([1.0, 0.0, 0.0])
    )
    assert met
    assert abs(theta) == pytest.approx(np.pi, abs=1e-6)


def test_a_ray_that_misses_gives_the_closest_place():
    cylinder = Surface.from_radius(np.full((360, 5), 0.1), np.linspace(0.0, 0.3, 5))
    (theta, z), met = place_on_ray(
        cylinder, np.array([0.12, -0.5, 0.2]), np.array([0.0, 1.0, 0.0])
    )
    assert not met
    assert theta == pytest.approx(0.0, abs=0.03)
    assert z == pytest.approx(0.2)
    (_, z), met = place_on_ray(
        cylinder, np.array([0.0, -0.5, 0.7]), np.array([0.0, 1.0, 0.0])
    )
    assert not met
    assert z == pytest.approx(0.3)  # beyond the last slice
