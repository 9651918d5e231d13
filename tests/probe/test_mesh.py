import numpy as np
import pytest
import trimesh

from tests.kit import FileError, GeometryError, InputError, refuses
from ttus_opt.probe.mesh import TriangleMesh, read_mesh


def written(folder, name, mesh):
    file = folder / name
    mesh.export(file)
    return file


@pytest.mark.parametrize("name", ["b.stl", "b.ply", "b.obj"])
def test_formats_give_the_same_mesh(tmp_path, name):
    file = written(tmp_path, name, trimesh.creation.box((40, 20, 10)))
    mesh = read_mesh(file, unit="mm")
    assert mesh.vertices.shape == (8, 3) and mesh.faces.shape == (12, 3)
    assert mesh.area == pytest.approx(2 * (8 + 4 + 2) * 1e-4, rel=1e-6)
    assert mesh.extent == pytest.approx(0.04, rel=1e-6)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1), ("cm", 0.1), ("m", 1e-3)])
def test_units_lead_to_metres(tmp_path, unit, factor):
    file = written(
        tmp_path, "b.stl", trimesh.creation.box(np.array([40, 20, 10]) * factor)
    )
    assert read_mesh(file, unit=unit).extent == pytest.approx(0.04, rel=1e-6)


def test_cleaning_welds_and_drops_degenerate_and_repeated_faces():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [2, 0, 0]]) * 0.01
    faces = np.array([[0, 1, 2], [3, 2, 1], [0, 1, 4], [0, 3, 1]])
    mesh = TriangleMesh(corners, faces).cleaned()
    assert len(mesh.vertices) == 3  # the fourth belonged to a dead face only
    assert len(mesh.faces) == 1
    assert mesh.area == pytest.approx(0.5e-4)


def test_hull_is_closed_and_wound_outwards():
    box = trimesh.creation.box((0.04, 0.02, 0.01))
    mesh = TriangleMesh(np.array(box.vertices), np.array(box.faces)).convex_hull()
    assert np.abs(mesh.vector_areas.sum(axis=0)).max() < 1e-18
    outward = (mesh.vector_areas * mesh.corners.mean(axis=1)).sum(axis=1)
    assert outward.min() > 0
    assert mesh.area == pytest.approx(28e-4)


def test_objects_of_one_file_are_one_mesh(tmp_path):
    text = "o one\nv 0 0 0\nv 40 0 0\nv 0 40 0\nf 1 2 3\n"
    text += "o two\nv 0 0 9\nv 40 0 9\nv 0 40 9\nv 40 40 9\nf 4 5 7 6\n"
    mesh = read_mesh(_text(tmp_path / "a.obj", text), unit="mm")
    assert len(mesh.faces) == 3
    assert mesh.area == pytest.approx((8 + 16) * 1e-4)


@pytest.mark.parametrize(
    ("make", "unit", "error", "text"),
    [
        (lambda f: f / "no.stl", "mm", FileError, "not found"),
        (lambda f: f, "mm", FileError, "folder"),
        (lambda f: _text(f / "a.step", "x"), "mm", FileError, "not one of"),
        (lambda f: _text(f / "a.stl", ""), "mm", FileError, "empty"),
        (lambda f: _text(f / "a.ply", "ply\nrubbish"), "mm", FileError, "cannot"),
        (lambda f: _truncated(f), "mm", FileError, "truncated"),
        (lambda f: _box(f, 40), "m", GeometryError, "millimetres"),
        (lambda f: _box(f, 0.04), "mm", GeometryError, "unit='m'"),
        (lambda f: _box(f, 40), "furlong", InputError, "unit must be"),
        (lambda f: _text(f / "a.obj", FLAT), "mm", GeometryError, "zero area"),
        (lambda f: _text(f / "a.obj", NAN), "mm", InputError, "not finite"),
        (lambda f: _text(f / "a.obj", HUGE), "mm", InputError, "or huge"),
        (lambda f: _text(f / "a.ply", NO_FACES), "mm", GeometryError, "no faces"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, make, unit, error, text):
    refuses(error, text, read_mesh, make(tmp_path), unit=unit)


FLAT = "v 0 0 0\nv 10 0 0\nv 20 0 0\nf 1 2 3\nf 3 2 1\n"
NAN = "v 0 0 0\nv 10 nan 0\nv 20 5 0\nf 1 2 3\n"
HUGE = "v 0 0 0\nv 1e160 0 0\nv 0 1e160 0\nf 1 2 3\n"
NO_FACES = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 0
property list uchar int vertex_indices
end_header
0 0 0
10 0 0
0 10 0
"""


def _text(file, text):
    file.write_text(text)
    return file


def _box(folder, size):
    return written(folder, "b.stl", trimesh.creation.box((size,) * 3))


def _truncated(folder):
    file = _box(folder, 40)
    file.write_bytes(file.read_bytes()[:-70])
    return file


@pytest.mark.parametrize(
    ("vertices", "faces", "text"),
    [
        (np.zeros((3, 4)), np.array([[0, 1, 2]]), "transposed"),
        (np.eye(3), np.array([[0, 1, 3]]), "there are 3"),
        (np.eye(3), np.zeros((0, 3), int), "no faces"),
    ],
)
def test_bad_arrays_are_refused(vertices, faces, text):
    refuses(InputError, text, TriangleMesh, vertices, faces)
