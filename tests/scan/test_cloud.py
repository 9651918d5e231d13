"""Reading clouds: every format gives the same points, every fault one line.

Damaged and hostile clouds: one of the package's own errors, never another.
"""

import io
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ttus_opt as tt
from tests.kit import FileError, InputError, TtusError, refuses, shared_data, torso
from ttus_opt.scan.cloud import extent_words, inside, read_cloud

POINTS = np.random.default_rng(0).uniform(-0.3, 0.3, (200, 3)).astype("<f4")


def pcd_header(n, encoding, *, fields="x y z rgb"):
    k = len(fields.split())
    return (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        f"FIELDS {fields}\nSIZE{' 4' * k}\nTYPE{' F' * k}\nCOUNT{' 1' * k}\n"
        f"WIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {encoding}\n"
    )


def lzf_compress(raw):
    """A naive LZF packer: the last place of each three bytes, at most 264 long."""
    out, literals, last = bytearray(), bytearray(), {}
    at = 0

    def flush():
        for start in range(0, len(literals), 32):
            piece = literals[start : start + 32]
            out.append(len(piece) - 1)
            out.extend(piece)
        literals.clear()

    while at < len(raw):
        key = raw[at : at + 3]
        found = last.get(key, -1) if len(key) == 3 else -1
        last[key] = at
        distance = at - found - 1
        if found < 0 or distance >= 8192:
            literals.append(raw[at])
            at += 1
            continue
        length = 3
        while length < 264 and raw[found + length : found + length + 1] == (
            raw[at + length : at + length + 1] or b"none"
        ):
            length += 1
        flush()
        if length - 2 < 7:
            out.append(((length - 2) << 5) | (distance >> 8))
        else:
            out.extend([(7 << 5) | (distance >> 8), length - 2 - 7])
        out.append(distance & 255)
        at += length
    flush()
    return bytes(out)


def write(path, points, kind):
    n = len(points)
    table = np.column_stack([points, np.arange(n)]).astype("<f4")
    if kind == "npy":
        np.save(path, points)
    elif kind in ("xyz", "csv"):
        header = "x,y,z" if kind == "csv" else ""
        np.savetxt(
            path,
            points,
            fmt="%.9g",
            delimiter="," if header else " ",
            header=header,
            comments="",
        )
    elif kind == "pcd-ascii":
        text = io.StringIO()
        np.savetxt(text, table, fmt="%.9g")
        path.write_text(pcd_header(n, "ascii") + text.getvalue())
    elif kind == "pcd-binary":
        path.write_bytes(pcd_header(n, "binary").encode() + table.tobytes())
    elif kind == "pcd-packed":
        raw = table.T.tobytes()
        packed = lzf_compress(raw)
        sizes = np.array([len(packed), len(raw)], "<u4").tobytes()
        path.write_bytes(pcd_header(n, "binary_compressed").encode() + sizes + packed)
    elif kind.startswith("ply"):
        binary = kind == "ply-binary"
        head = (
            f"ply\nformat {'binary_little_endian' if binary else 'ascii'} 1.0\n"
            f"element vertex {n}\nproperty float x\nproperty float y\n"
            "property float z\nend_header\n"
        ).encode()
        text = io.StringIO()
        np.savetxt(text, points, fmt="%.9g")
        body = points.astype("<f4").tobytes() if binary else text.getvalue().encode()
        path.write_bytes(head + body)
    return path


KINDS = {
    "npy": ".npy",
    "xyz": ".xyz",
    "csv": ".csv",
    "pcd-ascii": ".pcd",
    "pcd-binary": ".pcd",
    "pcd-packed": ".pcd",
    "ply-ascii": ".ply",
    "ply-binary": ".ply",
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("cm", 100), ("mm", 1000)])
def test_every_format_and_unit_gives_the_same_points(tmp_path, kind, unit, scale):
    path = write(tmp_path / f"cloud{KINDS[kind]}", POINTS * scale, kind)
    cloud = read_cloud(path, unit=unit)
    assert cloud.dtype == np.float64
    np.testing.assert_allclose(cloud, POINTS, rtol=3e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_nan_is_refused_with_the_remedy_and_dropped_on_request(tmp_path, kind):
    points = POINTS.copy()
    points[3, 1], points[50, 0] = np.nan, np.inf
    path = write(tmp_path / f"cloud{KINDS[kind]}", points, kind)
    refuses(InputError, r"2 of 200 points .* drop_nan=True", read_cloud, path)
    kept = np.delete(POINTS, [3, 50], axis=0)
    np.testing.assert_allclose(read_cloud(path, drop_nan=True), kept, rtol=3e-7)


def test_all_nan_is_refused_even_when_dropping(tmp_path):
    path = write(tmp_path / "c.npy", np.full((9, 3), np.nan), "npy")
    refuses(InputError, "no point has finite", read_cloud, path, drop_nan=True)


@pytest.mark.parametrize(
    ("scale", "unit", "message"),
    [
        (1000, None, r"extent is 59\d\.?\d?: are these millimetres\? pass unit='mm'"),
        (100, None, r"are these centimetres\? pass unit='cm'"),
        (1, "mm", r"read with unit='mm': are these metres\? pass unit='m'"),
        (1e6, None, "crop a room to the patient by box="),
        (1e-9, "m", "check its unit"),
        (1, "inch", "one of m, cm, mm"),
    ],
)
def test_implausible_extents_and_units(tmp_path, scale, unit, message):
    path = write(tmp_path / "c.npy", POINTS.astype(float) * scale, "npy")
    refuses(InputError, message, read_cloud, path, unit=unit)


@pytest.mark.parametrize(
    "kind", ["pcd-ascii", "pcd-binary", "pcd-packed", "ply-ascii", "ply-binary", "npy"]
)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.99])
def test_truncated_files_are_refused(tmp_path, kind, share):
    path = write(tmp_path / f"cloud{KINDS[kind]}", POINTS, kind)
    raw = path.read_bytes()
    path.write_bytes(raw[: int(share * len(raw))])
    caught = refuses(FileError, "", read_cloud, path)
    if share == 0.7 and kind != "npy":
        assert "truncated" in caught


def test_header_promises_more_points_than_the_file_holds(tmp_path):
    path = write(tmp_path / "c.pcd", POINTS, "pcd-binary")
    path.write_bytes(path.read_bytes().replace(b"POINTS 200", b"POINTS 250"))
    refuses(FileError, "announces 250 points, it holds 200", read_cloud, path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("c.xyz", "1 2\n3 4\n", "2 columns, expected x, y, z"),
        ("c.xyz", "0 0 0 9 9\n1 1 1 9 9\n", "5 columns, expected x, y, z"),
        ("c.xyz", "0 0 0\n1 1\n", "line 2: 2 columns, expected 3"),
        ("c.xyz", "0 9 9 9\n1 9 9 9\n2 9 9 9\n", "the first column counts"),
        ("c.pts", "3\n0 0 0\n1 1 1\n", "announces 3 points .* holds 2"),
        ("c.csv", "x,y,z,r\n0,0,0\n", "names 4 columns, its points have 3"),
        ("c.csv", "x,y,z\n0,0,0\n1,abc,1\n", "not a number"),
        ("c.csv", "x,y,w\n0,0,0\n", "expected x, y and z"),
        ("c.csv", "x,y,z\n", "no points"),
        ("c.txt", "# nothing\n", "no points"),
        ("c.xyz", b"\xff\x00\x81", "not a text file"),
        ("c.obj", "v 0 0 0\n", "suffix '.obj', expected one of"),
        ("c.pcd", "hello\n", "no PCD header"),
        ("c.pcd", pcd_header(1, "ascii", fields="x y w") + "0 0 0\n", "expected x, y"),
        ("c.pcd", pcd_header(1, "zip") + "0 0 0 0\n", "kind 'zip'"),
        ("c.pcd", pcd_header(1, "ascii") + "0 0 0\n", "3 values, expected 4"),
        ("c.pcd", pcd_header(1, "ascii") + "0 0 a 0\n", "not a number"),
        ("c.pcd", pcd_header(0, "ascii"), "no points"),
        ("c.pcd", pcd_header(0, "binary"), "no points"),
        ("c.pcd", pcd_header(0, "binary_compressed") + "\0" * 8, "no points"),
        ("c.pcd", pcd_header(1, "ascii").replace("SIZE 4", "SIZE 3"), "damaged"),
        ("c.ply", "solid cube\n", "not a PLY"),
        ("c.ply", "ply\nformat ascii 1.0\nend_header\n", "no vertices"),
    ],
)
def test_faults_are_one_line_each(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    refuses(FileError, message, read_cloud, path)


def test_missing_file_and_folder(tmp_path):
    refuses(FileError, "not found", read_cloud, tmp_path / "none.ply")
    refuses(FileError, "is a folder", read_cloud, tmp_path)


def test_columns_are_picked_by_name(tmp_path):
    path = tmp_path / "c.csv"
    rows = ["i;z;y;x"] + [f"{m};{z};{y};{x}" for m, (x, y, z) in enumerate(POINTS)]
    path.write_text("\n".join(rows))
    np.testing.assert_allclose(read_cloud(path), POINTS, rtol=1e-6)


def test_transposed_array(tmp_path):
    path = write(tmp_path / "c.npy", POINTS.T, "npy")
    refuses(FileError, "transposed", read_cloud, path)


@settings(max_examples=60)
@given(st.binary(max_size=300), st.sampled_from([".pcd", ".ply", ".npy", ".csv"]))
def test_any_bytes_are_read_or_refused(tmp_path_factory, raw, suffix):
    path = tmp_path_factory.mktemp("bytes") / f"c{suffix}"
    path.write_bytes(raw)
    try:
        cloud = read_cloud(path)
    except TtusError as error:
        assert "\n" not in str(error)
    else:
        assert cloud.ndim == 2 and cloud.shape[1] == 3


@pytest.mark.parametrize(
    ("name", "unit", "n"),
    [("realsense_male_m.pcd", "m", 61372), ("ct_skin_mm.ply", "mm", 66206)],
)
def test_real_files(name, unit, n):
    path = shared_data(f"torso/{name}")
    cloud = read_cloud(path, unit=unit)
    assert cloud.shape == (n, 3)
    assert 0.3 < np.ptp(cloud, axis=0).max() < 0.7
    if unit == "mm":
        refuses(InputError, "unit='mm'", read_cloud, path)


CLOUD = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 3))


def test_it_keeps_the_points_inside_in_their_order():
    box = [-0.5, 0.5, -1.0, 0.0, 0.2, np.inf]
    expected = [
        p for p in CLOUD if -0.5 <= p[0] <= 0.5 and -1.0 <= p[1] <= 0.0 and p[2] >= 0.2
    ]
    assert 10 < len(expected) < 200
    np.testing.assert_array_equal(CLOUD[inside(CLOUD, box)], expected)


def test_a_point_on_a_side_is_inside():
    corner = np.array([[0.0, 1.0, 2.0]])
    assert inside(corner, [0, 1, 0, 1, 0, 2]).sum() == 1


@pytest.mark.parametrize(
    ("box", "told"),
    [
        ([0, 1, 0, 1], "a box is xmin,xmax"),
        ([0, 1, 0, np.nan, 0, 1], "a box is xmin,xmax"),
        ([0, 1, 1, 1, 0, 1], "ymin 1 and ymax 1"),
        ([0, 1, 0, 1, 3, 2], "zmin 3 and zmax 2"),
        ([5, 6, 0, 1, 0, 1], "no point lies in the box: the scan reaches x -"),
    ],
)
def test_other_boxes_are_refused(box, told):
    refuses(InputError, told, inside, CLOUD, box)


def test_the_extent_in_words():
    ends = np.array([[0.0, -1.0, 0.25], [0.5, 2.0, 0.2504]])
    assert extent_words(ends) == "x 0.000 to 0.500, y -1.000 to 2.000, z 0.250 to 0.250"


SKIN = torso(40, 12).points().reshape(-1, 3)


def npy_header(text):
    header = text.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header


def archive():
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as file:
        file.writestr("x.npy", b"nothing")
    return made.getvalue()


PCD = (
    "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT {count}\n"
    "WIDTH 2\nHEIGHT 1\nPOINTS {points}\nDATA {kind}\n"
)
HOSTILE = {
    "damaged.npy": npy_header("{'descr': '<f8', 'fortran_order': (((, 'shape': 3}"),
    "zip.npy": b"PK\x03\x04 and nothing more",
    "archive.npy": archive(),
    "endless.npy": npy_header(
        f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({10**23}, 3), }}"
    ),
    "huge.npy": npy_header(
        f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({10**12}, 3), }}"
    ),
    "zero.pcd": PCD.format(count="0 0 0", points=2, kind="binary").encode() + bytes(24),
    "minus.pcd": PCD.format(count="-1 1 1", points=2, kind="ascii").encode() + b"1 1\n",
    "count.pcd": PCD.format(count="1 1 99999999", points=2, kind="binary").encode(),
    "points.pcd": PCD.format(count="1 1 1", points=10**15, kind="ascii").encode(),
    "digits.ply": b"ply\nformat ascii 1.0\nelement vertex " + b"9" * 5000 + b"\nend",
    "many.ply": b"ply\nformat ascii 1.0\nelement vertex 999999999999\n"
    b"property float x\nproperty float y\nproperty float z\nend_header\n",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_one_line_that_names_the_file(name, tmp_path):
    (tmp_path / name).write_bytes(HOSTILE[name])
    refuses(FileError, name, read_cloud, tmp_path / name)


def seeds(folder):
    """A sound file of every kind."""
    import trimesh

    np.save(folder / "a.npy", SKIN)
    np.savetxt(folder / "a.csv", SKIN, delimiter=",", header="x,y,z", comments="")
    np.savetxt(folder / "a.xyz", SKIN)
    coloured = np.hstack([SKIN, np.full_like(SKIN, 9)])
    np.savetxt(
        folder / "count.pts", coloured, header=str(len(coloured)), comments="", fmt="%g"
    )
    np.savetxt(folder / "named.txt", coloured, delimiter=";", header="X;Y;Z;r;g;b")
    for encoding in ("ascii", "binary"):
        data = trimesh.PointCloud(SKIN).export(file_type="ply", encoding=encoding)
        (folder / f"{encoding}.ply").write_bytes(data)
    head = PCD.replace("WIDTH 2", f"WIDTH {len(SKIN)}")
    binary = head.format(count="1 1 1", points=len(SKIN), kind="binary").encode()
    (folder / "b.pcd").write_bytes(binary + SKIN.astype("<f4").tobytes())
    return sorted(folder.iterdir())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")  # front and head, of noise
def test_a_cloud_that_fills_a_volume_is_refused():
    rng = np.random.default_rng(0)
    cloud = rng.uniform(-0.3, 0.3, (5_000, 3))
    refuses(TtusError, "", tt.extract_surface, cloud, axis=tt.Axis.from_cloud(cloud))
