"""Damaged and hostile clouds: one of the package's own errors, never another."""

import io
import zipfile

import numpy as np
import pytest

import ttus_opt as tt
from tests.conftest import torso
from tests.hostile import NUMBERS, only_our_errors
from tests.refusals import refuses
from ttus_opt.core.errors import FileError, TtusError
from ttus_opt.scan.cloud import read_cloud

POINTS = torso(40, 12).points().reshape(-1, 3)


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

    np.save(folder / "a.npy", POINTS)
    np.savetxt(folder / "a.csv", POINTS, delimiter=",", header="x,y,z", comments="")
    np.savetxt(folder / "a.xyz", POINTS)
    coloured = np.hstack([POINTS, np.full_like(POINTS, 9)])
    np.savetxt(
        folder / "count.pts", coloured, header=str(len(coloured)), comments="", fmt="%g"
    )
    np.savetxt(folder / "named.txt", coloured, delimiter=";", header="X;Y;Z;r;g;b")
    for encoding in ("ascii", "binary"):
        data = trimesh.PointCloud(POINTS).export(file_type="ply", encoding=encoding)
        (folder / f"{encoding}.ply").write_bytes(data)
    head = PCD.replace("WIDTH 2", f"WIDTH {len(POINTS)}")
    binary = head.format(count="1 1 1", points=len(POINTS), kind="binary").encode()
    (folder / "b.pcd").write_bytes(binary + POINTS.astype("<f4").tobytes())
    return sorted(folder.iterdir())


@pytest.mark.parametrize("n", NUMBERS)
@pytest.mark.filterwarnings("ignore")
def test_mutations_raise_nothing_but_our_own(n, tmp_path):
    only_our_errors(seeds(tmp_path), read_cloud, n)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")  # front and head, of noise
def test_a_cloud_that_fills_a_volume_is_refused():
    rng = np.random.default_rng(0)
    cloud = rng.uniform(-0.3, 0.3, (5_000, 3))
    refuses(TtusError, "", tt.extract_surface, cloud, axis=tt.Axis.from_cloud(cloud))
