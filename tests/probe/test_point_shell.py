import functools

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from tests.kit import SHARED, FileError, GeometryError, InputError, TtusWarning, refuses
from ttus_opt.probe import orientation
from ttus_opt.probe.mesh import TriangleMesh
from ttus_opt.probe.point_shell import PointShell, ellipsoid_area

PROBE = SHARED / "probe" / "Probe_L14-5_38_lowres.stl"
needs_probe = pytest.mark.skipif(
    not PROBE.exists(), reason="shared probe mesh is not here"
)

AXES = (0.030, 0.0125, 0.018)
PRIMITIVES = {
    "ellipsoid": functools.cache(lambda: PointShell.ellipsoid(AXES, 1500)),
    "sphere": functools.cache(lambda: PointShell.sphere(0.02, 1500)),
    "box": functools.cache(lambda: PointShell.box((0.05, 0.02, 0.01), 1500)),
}


def variation(points):
    distance = KDTree(points).query(points, k=2)[0][:, 1]
    return distance.std() / distance.mean()


@pytest.mark.slow
@pytest.mark.parametrize("name", PRIMITIVES)
def test_laws_of_a_closed_surface(name):
    shell = PRIMITIVES[name]()
    assert len(shell) == 1500
    net = shell.areas @ shell.normals
    assert np.linalg.norm(net) < 1e-12 * shell.total_area
    centroid = shell.areas @ shell.points / shell.total_area
    np.testing.assert_allclose(centroid, 0, atol=1e-12)
    np.testing.assert_array_equal(shell.reference, 0)
    # Gauss: ∫ x·n̂ dA = 3 volumes, with inward normals its negative
    volume = -(shell.areas * (shell.points * shell.normals).sum(axis=1)).sum() / 3
    truth = {
        "ellipsoid": 4 / 3 * np.pi * np.prod(AXES),
        "sphere": 4 / 3 * np.pi * 0.02**3,
        "box": 1e-5,
    }
    assert volume == pytest.approx(truth[name], rel=5e-3)
    assert variation(shell.points) < 0.2


def test_ellipsoid_points_normals_and_area_are_exact():
    shell = PointShell.ellipsoid(AXES, 500)
    scaled = shell.points / AXES
    np.testing.assert_allclose((scaled**2).sum(axis=1), 1, atol=1e-12)
    gradient = shell.points / np.square(AXES)
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    np.testing.assert_allclose(shell.normals, -gradient, atol=1e-12)
    assert shell.total_area == pytest.approx(ellipsoid_area(np.array(AXES)), rel=1e-12)


def test_ellipsoid_area_against_closed_form_and_mesh():
    assert ellipsoid_area(np.array([0.02] * 3)) == pytest.approx(4 * np.pi * 4e-4)
    a, c = 0.01, 0.03  # prolate spheroid
    e = np.sqrt(1 - a**2 / c**2)
    prolate = 2 * np.pi * a**2 * (1 + c / (a * e) * np.arcsin(e))
    assert ellipsoid_area(np.array([a, a, c])) == pytest.approx(prolate, rel=1e-12)
    mesh = trimesh.creation.icosphere(subdivisions=5)
    mesh.apply_scale(AXES)
    assert ellipsoid_area(np.array(AXES)) == pytest.approx(mesh.area, rel=2e-3)


def test_box_spans_full_edges_with_exact_normals():
    shell = PRIMITIVES["box"]()
    np.testing.assert_allclose(np.abs(shell.points).max(axis=0), [0.025, 0.01, 0.005])
    axis = np.abs(shell.normals).argmax(axis=1)
    np.testing.assert_allclose(np.abs(shell.normals).max(axis=1), 1)
    outermost = np.abs(shell.points)[np.arange(1500), axis]
    np.testing.assert_allclose(outermost, np.array([0.025, 0.01, 0.005])[axis])
    for d, face in enumerate([2e-4, 5e-4, 1e-3]):
        assert shell.areas[axis == d].sum() == pytest.approx(2 * face, rel=0.02)


def test_rms_radius_weighs_points_by_their_area():
    points = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 3, 0], [0, -3, 0]])
    areas = np.array([3.0, 3.0, 1.0, 1.0])
    shell = PointShell(points, points / [[1], [1], [3], [3]], areas, np.zeros(3))
    assert shell.rms_radius == pytest.approx(np.sqrt((6 * 1 + 2 * 9) / 8))


def test_the_seed_decides():
    one, two = PointShell.sphere(0.02, 64), PointShell.sphere(0.02, 64)
    np.testing.assert_array_equal(one.points, two.points)
    other = PointShell.sphere(0.02, 64, seed=1)
    assert np.abs(other.points - one.points).max() > 1e-3
    rng = np.random.default_rng(0)
    passed, on = (PointShell.sphere(0.02, 64, seed=rng) for _ in range(2))
    np.testing.assert_array_equal(passed.points, one.points)
    assert np.abs(on.points - one.points).max() > 1e-3
    for array in (one.points, one.normals, one.areas):  # one's own
        array[:] = 0.0
    again = PointShell.sphere(0.02, 64)
    for name in ("points", "normals", "areas"):
        np.testing.assert_array_equal(getattr(again, name), getattr(two, name))


@pytest.mark.parametrize("n_points", [4, 5, 49, 50])
def test_small_counts(n_points):
    shell = PointShell.ellipsoid(AXES, n_points)
    assert len(shell) == n_points
    assert shell.total_area == pytest.approx(ellipsoid_area(np.array(AXES)))


def capsule():
    made = trimesh.creation.capsule(height=0.05, radius=0.015, count=[12, 12])
    vertices = np.array(made.vertices) + np.array([0.01, 0.02, 0.03])
    return vertices, np.array(made.faces), made.area


@functools.cache
def capsule_shell():
    vertices, faces, _ = capsule()
    return PointShell.from_triangles(vertices, faces, 120)


def test_mesh_area_centroid_and_closed_law():
    vertices, faces, area = capsule()
    shell = PointShell.from_triangles(vertices, faces, 800)
    assert shell.total_area == pytest.approx(area, rel=1e-12)
    assert np.linalg.norm(shell.areas @ shell.normals) < 1e-12 * area
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    np.testing.assert_allclose(shell.reference, centre, atol=1e-8)
    inward = ((shell.reference - shell.points) * shell.normals).sum(axis=1)
    assert inward.min() > 0  # convex: every normal has the centre before it
    assert variation(shell.points) < 0.2


@pytest.mark.slow
@settings(max_examples=6)
@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    shift=st.tuples(*[st.floats(-0.5, 0.5)] * 3),
    scale=st.floats(0.1, 4.0),
)
def test_moving_and_scaling_the_mesh_moves_and_scales_the_shell(turn, shift, scale):
    vertices, faces, _ = capsule()
    rotation = Rotation.from_rotvec(turn).as_matrix()
    base = capsule_shell()
    moved = PointShell.from_triangles(scale * vertices @ rotation.T + shift, faces, 120)
    assert moved.total_area == pytest.approx(scale**2 * base.total_area, rel=1e-9)
    assert moved.rms_radius == pytest.approx(scale * base.rms_radius, rel=1e-6)
    np.testing.assert_allclose(
        moved.reference, scale * rotation @ base.reference + shift, atol=1e-9
    )
    np.testing.assert_allclose(
        moved.points, scale * base.points @ rotation.T + shift, atol=1e-9
    )
    np.testing.assert_allclose(moved.normals, base.normals @ rotation.T, atol=1e-6)


def test_inner_walls_are_left_out_unless_asked_for():
    outer = trimesh.creation.box((0.05, 0.02, 0.01))
    inner = trimesh.creation.box((0.046, 0.016, 0.006))
    vertices = np.vstack([outer.vertices, inner.vertices])
    faces = np.vstack([outer.faces, inner.faces + 8])  # wound the wrong way
    shell = PointShell.from_triangles(vertices, faces, 100)
    assert shell.total_area == pytest.approx(outer.area)
    assert (shell.points * shell.normals).sum(axis=1).max() < 0
    both = PointShell.from_triangles(vertices, faces, 200, surface="all")
    assert both.total_area == pytest.approx(outer.area + inner.area)
    # on the inner box the material is outside of it
    on_inner = (np.abs(both.points) < [0.0231, 0.0081, 0.0031]).all(axis=1)
    assert on_inner.sum() > 33
    assert (both.points * both.normals).sum(axis=1)[on_inner].min() > 0


def test_a_missing_face_is_told_and_the_hull_closes_it():
    made = trimesh.creation.box((0.05, 0.02, 0.01))
    vertices, faces = np.array(made.vertices), np.array(made.faces)
    faces = faces[np.asarray(made.face_normals)[:, 1] > -0.5]
    with pytest.warns(TtusWarning, match=r"open by 5 cm².*\(-?0.00, -1.00, -?0.00\)"):
        shell = PointShell.from_triangles(vertices, faces, 300)
    assert shell.total_area == pytest.approx(34e-4 - 5e-4)
    closed = PointShell.from_triangles(vertices, faces, 300, surface="hull")
    assert closed.total_area == pytest.approx(34e-4)
    assert np.linalg.norm(closed.areas @ closed.normals) < 1e-15


@pytest.mark.parametrize("end", [-1, 1])
def test_a_hole_is_told_where_it_is(end):
    """An opening of 5 cm² where the cable leaves is not one of the contact face."""
    made = trimesh.creation.box((0.02, 0.08, 0.025)).subdivide_to_size(0.016)
    middle = made.triangles_center
    hole = np.abs(middle[:, 1] - end * 0.04) < 1e-6
    faces = np.array(made.faces)[~hole]
    sign = "+" if end > 0 else "-"
    words = rf"open by 5 cm².*around \(-?0, {end * 40}, -?0\) mm, at the \{sign}y end"
    with pytest.warns(TtusWarning, match=words):
        PointShell.from_triangles(np.array(made.vertices), faces, 100)


@pytest.mark.slow
def test_a_fine_mesh_votes_by_groups_as_a_coarse_one_face_by_face():
    """Turned faces, an inner wall and a torus: the same answer from fewer votes."""
    made = trimesh.creation.torus(0.03, 0.01, major_sections=160, minor_sections=120)
    mesh = TriangleMesh(np.array(made.vertices), np.array(made.faces, np.int64))
    assert len(mesh.faces) > orientation.FINE_MESH
    rng = np.random.default_rng(0)
    turned = rng.random(len(mesh.faces)) < 0.3
    found = orientation.orient_faces(mesh.flipped(turned), rng)
    np.testing.assert_array_equal(found.flip, turned)
    coarse = trimesh.creation.torus(0.03, 0.01, major_sections=40, minor_sections=30)
    few = TriangleMesh(np.array(coarse.vertices), np.array(coarse.faces, np.int64))
    whole = orientation.orient_faces(few, rng)
    mean = np.average(found.exposure, weights=mesh.areas)
    assert mean == pytest.approx(
        np.average(whole.exposure, weights=few.areas), abs=0.01
    )


@pytest.mark.slow
@needs_probe
def test_real_probe():
    with pytest.warns(TtusWarning, match=r"largest hole around \(30, 40, 19\) mm"):
        shell = PointShell.from_mesh(PROBE, 800)
    size = np.ptp(shell.points, axis=0)
    np.testing.assert_allclose(size, [0.058, 0.132, 0.0245], atol=1.5e-3)
    # a housing: its outer side is a little less than the hull, half of all faces
    hull = PointShell.from_mesh(PROBE, 800, surface="hull")
    assert 0.85 < shell.total_area / hull.total_area < 1.0
    assert np.linalg.norm(hull.areas @ hull.normals) < 1e-12 * hull.total_area
    # from outside in: against the middle line of the handle, well off its ends
    handle = (shell.points[:, 1] > 0.035) & (shell.points[:, 1] < 0.08)
    across = (shell.points - shell.reference)[handle][:, [0, 2]]
    facing = (across * shell.normals[handle][:, [0, 2]]).sum(axis=1)
    assert shell.areas[handle][facing < 0].sum() > 0.97 * shell.areas[handle].sum()


def test_specifications():
    ellipsoid = PointShell.from_spec("ellipsoid:0.030,0.0125,0.018", 64)
    np.testing.assert_array_equal(
        ellipsoid.points, PointShell.ellipsoid(AXES, 64).points
    )
    sphere = PointShell.from_spec("sphere: 0.02", 64)
    assert sphere.total_area == pytest.approx(4 * np.pi * 4e-4)
    box = PointShell.from_spec("box:0.05,0.02,0.01", 64)
    assert box.total_area == pytest.approx(34e-4)


def test_a_shell_is_told_by_its_size():
    """Millimetres of the box around its points, and square centimetres."""
    points = np.array([[10.0, 0, -20], [30, 5, 0], [20, 45, 0], [20, 9, 9]]) * 1e-3
    areas = np.array([0.5, 1.0, 1.0, 1.25]) * 1e-4
    shell = PointShell(points, np.tile([0.0, 0.0, 1.0], (4, 1)), areas, np.zeros(3))
    assert repr(shell) == "PointShell(4 points, 20 × 45 × 29 mm, 3.75 cm²)"


def test_a_specification_may_be_a_path(tmp_path):
    trimesh.creation.box((50, 20, 10)).export(tmp_path / "b.stl")
    shell = PointShell.from_spec(tmp_path / "b.stl", 64)
    assert shell.total_area == pytest.approx(34e-4, rel=1e-6)
    with pytest.raises(GeometryError, match="millimetres"):
        PointShell.from_spec(str(tmp_path / "b.stl"), 64, unit="m")
    refuses(FileError, "not found", PointShell.from_spec, "nowhere.stl")


@pytest.mark.parametrize(
    "spec",
    ["ellipsoid:0.03,0.01", "sphere:", "sphere:a", "box:1,2,3,4", "cone:0.1,0.2"],
)
def test_bad_specifications_name_the_three_forms(spec):
    with pytest.raises(InputError, match=r"ellipsoid:a,b,c .*sphere:r.*box:a,b,c"):
        PointShell.from_spec(spec)


@pytest.mark.parametrize(
    ("make", "error", "text"),
    [
        (lambda: PointShell.sphere(0.0), InputError, "positive"),
        (lambda: PointShell.sphere(float("nan")), InputError, "positive"),
        (lambda: PointShell.box((0.1, -0.1, 0.1)), InputError, "positive"),
        (lambda: PointShell.ellipsoid((0.1, 0.1)), InputError, "3 positive"),
        (lambda: PointShell.sphere(20.0), GeometryError, "measures in metres"),
        (lambda: PointShell.sphere(2e-4), GeometryError, "expected a probe"),
        (lambda: PointShell.sphere(0.02, 3), InputError, "at least 4"),
        (lambda: PointShell.sphere(0.02, 10**20), InputError, "at most 1,000,000"),
        (lambda: PointShell.from_triangles(*capsule()[:2], 2), InputError, "least 4"),
        (
            lambda: PointShell.from_triangles(*capsule()[:2], surface="inner"),
            InputError,
            "outer, all, hull",
        ),
        (
            lambda: PointShell.from_triangles(np.zeros((3, 3)), np.array([[0, 1, 2]])),
            GeometryError,
            "zero area",
        ),
        (
            lambda: PointShell.from_triangles(
                np.array([[0, 0, np.nan], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])
            ),
            InputError,
            "not finite",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(make, error, text):
    refuses(error, text, make)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"points": np.zeros((3, 8))}, "points must have shape"),
        ({"normals": np.ones((8, 3))}, "unit vectors"),
        ({"areas": np.zeros(8)}, "zero area"),
        ({"reference": np.full(3, np.nan)}, "finite"),
    ],
)
def test_a_shell_is_validated(change, text):
    normals = np.tile([0.0, 0.0, 1.0], (8, 1))
    parts = {"points": normals.copy(), "normals": normals, "areas": np.ones(8)}
    parts = {**parts, "reference": np.zeros(3), **change}
    refuses(InputError, text, PointShell, **parts)
