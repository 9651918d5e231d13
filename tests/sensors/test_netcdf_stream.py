"""netCDF streams: dimensions, units and orders checked."""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from tests.hostile import only_our_errors
from tests.kit import FileError, TtusWarning, refuses
from ttus_opt.core import netcdf_file
from ttus_opt.sensors.netcdf_stream import write_netcdf_wrenches
from ttus_opt.sensors.stream_files import read_poses, read_wrenches
from ttus_opt.sensors.streams import WrenchStream

TIME = 100.0 + 0.05 * np.arange(8)
TURNS = Rotation.from_rotvec(np.outer(np.arange(8), [0.1, -0.05, 0.02]))
PLACE = np.outer(np.arange(8), [0.01, 0.02, -0.03])


def poses(order="xyzw", labelled=True):
    quaternion = TURNS.as_quat()
    if order == "wxyz":
        quaternion = np.roll(quaternion, 1, axis=1)
    coords: dict[str, Any] = {"time": ("time", TIME, {"units": "s"})}
    if labelled:
        coords |= {"axis": list("xyz"), "component": list(order)}
    return xr.Dataset(
        {
            "position": (("time", "axis"), PLACE, {"units": "m"}),
            "quaternion": (("time", "component"), quaternion, {"units": "1"}),
        },
        coords,
    )


def written(data, file):
    data.to_netcdf(file, engine="netcdf4")
    return file


#: Reads one file after the other, an answer of length 0 where it cannot
SERVE = """
import runpy, struct, sys
child = runpy.run_path(sys.argv[1])
for line in sys.stdin:
    child["limit_memory"](line[:-1])
    try:
        content = child["packed"](line[:-1])
    except Exception:
        content = b""
    sys.stdout.buffer.write(struct.pack("<Q", len(content)) + content)
    sys.stdout.buffer.flush()
"""


class Server:
    """`contents_apart` by a process for many files, and a new one after a crash."""

    def __init__(self):
        self.crashes = 0
        self._process: subprocess.Popen[bytes] | None = None

    def read(self, file):
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", SERVE, netcdf_file.__file__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **netcdf_file.ONE_THREAD},
            )
        there, back = self._process.stdin, self._process.stdout
        there.write(f"{file}\n".encode())
        there.flush()
        head = back.read(8)
        if len(head) < 8:
            self.crashes += 1
            self.end()
            raise ValueError("its reader crashed")
        content = back.read(int.from_bytes(head, "little"))
        if not content:
            raise ValueError("its reader gave up")
        return netcdf_file.unpacked(content)

    def end(self):
        if self._process is not None:
            for stream in (self._process.stdin, self._process.stdout):
                with contextlib.suppress(OSError):
                    stream.close()
            self._process.kill()
            self._process.wait()
            self._process = None


@pytest.fixture(scope="module")
def server():
    one = Server()
    yield one
    one.end()


@pytest.fixture
def quick(monkeypatch, server):
    monkeypatch.setattr(netcdf_file, "contents_apart", server.read)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
def test_poses(tmp_path, order):
    """By labels, by the file's attribute, or told; the same poses."""
    data = poses(order)
    bare = poses(order, labelled=False)
    stated = bare.assign(quaternion=bare.quaternion.assign_attrs(order=order))
    told = {"quaternion_order": order}
    for i, (content, columns) in enumerate(
        [(data, None), (stated, None), (bare, told), (data, told)]
    ):
        found = read_poses(written(content, tmp_path / f"{i}.nc"), columns=columns)
        np.testing.assert_array_equal(found.time, TIME)
        np.testing.assert_allclose(found.position, PLACE)
        np.testing.assert_allclose(found.rotation, TURNS.as_matrix(), atol=1e-12)


@pytest.fixture
def elsewhere(monkeypatch):
    """A machine nine hours ahead; an origin without a time zone is UTC all the same."""
    monkeypatch.setenv("TZ", "JST-9")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.usefixtures("quick", "elsewhere")
def test_other_units_and_names(tmp_path):
    data = poses().rename(position="tip", time="stamp")
    data["tip"] = (1e3 * data.tip).assign_attrs(units="mm")
    stamp = ("stamp", 1e3 * TIME, {"units": "milliseconds since 1970-01-01"})
    data = data.assign_coords(stamp=stamp)
    file = written(data, tmp_path / "p.nc")
    found = read_poses(file, columns={"t": "stamp", "position": "tip"})
    np.testing.assert_allclose(found.time, TIME)
    np.testing.assert_allclose(found.position, PLACE)
    for origin, first in (("1970-01-01 00:00:02", 2.0), ("1970-01-01T00:01:00Z", 60.0)):
        data.stamp.attrs["units"] = f"milliseconds since {origin}"
        since = written(data, tmp_path / f"{first:g}.nc")
        later = read_poses(since, columns={"t": "stamp", "position": "tip"})
        np.testing.assert_allclose(later.time, first + TIME)
    data.stamp.attrs["units"] = "milliseconds since the start"
    since = written(data, tmp_path / "start.nc")
    with pytest.raises(FileError, match="since 'the start'"):
        read_poses(since, columns={"t": "stamp", "position": "tip"})
    refuses(FileError, r"no variable time, but.*t=…", read_poses, file)


def test_wrenches_there_and_back(tmp_path):
    stream = WrenchStream(TIME, PLACE + 1.0, PLACE - 2.0)
    write_netcdf_wrenches(stream, tmp_path / "w.nc")
    found = read_wrenches(tmp_path / "w.nc")
    np.testing.assert_array_equal(found.force, stream.force)
    np.testing.assert_array_equal(found.torque, stream.torque)
    alone = WrenchStream(TIME, PLACE)
    write_netcdf_wrenches(alone, tmp_path / "f.nc")
    assert read_wrenches(tmp_path / "f.nc").torque is None


def late(data):
    return data.assign_coords(time=("time", TIME[::-1].copy(), {"units": "s"}))


def gone(data):
    place = data.position.copy()
    place[3, 1] = np.nan
    return data.assign(position=place.assign_attrs(units="m"))


SPOILT: dict[str, Callable[[xr.Dataset], xr.Dataset]] = {
    "no order": lambda data: poses(labelled=False),
    "orders": lambda d: d.assign(quaternion=d.quaternion.assign_attrs(order="wxyz")),
    "no unit": lambda d: d.assign(position=(d.position.dims, d.position.values)),
    "unit": lambda d: d.assign(position=d.position.assign_attrs(units="inch")),
    "transposed": lambda d: d.assign(position=d.position.T),
    "swapped": lambda d: d.assign_coords(axis=["y", "x", "z"]),
    "missing": lambda d: d.drop_vars("quaternion"),
    "text": lambda d: d.assign(position=d.position.astype(str)),
    "gone": gone,
    "late": late,
    "long": lambda d: d.assign(position=(1e6 * d.position).assign_attrs(units="m")),
}


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no order", "never guessed"),
        ("orders", "wxyz and xyzw"),
        ("no unit", "units None, expected m or cm or mm"),
        ("unit", "units 'inch'"),
        ("transposed", "transpose it"),
        ("swapped", "are y, x, z, expected x, y, z"),
        ("missing", "no variable quaternion"),
        ("text", "not hold numbers"),
        ("gone", "frame 3: py is nan"),
        ("late", "goes back"),
        ("long", "check units"),
    ],
)
def test_what_is_refused(tmp_path, name, words):
    file = written(SPOILT[name](poses()), tmp_path / "p.nc")
    refuses(FileError, words, read_poses, file)


def test_files_that_are_none(tmp_path):
    (tmp_path / "p.nc").write_text("t,px,py,pz")
    refuses(FileError, "not a readable netCDF", read_poses, tmp_path / "p.nc")
    with pytest.raises(FileError, match="whole vectors"):
        read_poses(tmp_path / "p.nc", columns={"px": "x"})


@pytest.mark.parametrize(
    "n", [60, pytest.param(3000, marks=[pytest.mark.slow, pytest.mark.long])]
)
@pytest.mark.usefixtures("quick")
def test_mutations(tmp_path, n, server):
    """Some of these crash the netCDF library: in its own process alone.

    HDF5 refuses nearly all of them; netCDF-3 has no checksums, and what it reads all
    the same is ours to check.
    """
    classic = poses(labelled=False)
    classic["quaternion"].attrs["order"] = "xyzw"
    classic.to_netcdf(
        tmp_path / "c.nc", engine="netcdf4", format="NETCDF3_64BIT_OFFSET"
    )
    sources = [tmp_path / "c.nc", written(poses(), tmp_path / "p.nc")]
    for source in sources:
        read_poses(source)  # or nothing is tested
    only_our_errors(sources, read_poses, n)
    print(f"{server.crashes} crashes")


def test_a_reader_that_crashes(tmp_path, monkeypatch):
    (tmp_path / "crash.py").write_text("import os\nos.abort()\n")
    monkeypatch.setattr(netcdf_file, "__file__", str(tmp_path / "crash.py"))
    file = written(poses(), tmp_path / "p.nc")
    refuses(FileError, "not a readable netCDF", read_poses, file)


@pytest.mark.parametrize("suffix", ["nc", "csv"])
def test_repeated_wrenches_are_left_out(tmp_path, suffix):
    file = tmp_path / f"w.{suffix}"
    if suffix == "csv":
        file.write_text("t,fx,fy,fz\n0,1,2,3\n1,1,2,3\n1,1,2,3\n2,0,0,0\n")
    else:
        twice = np.array([0.0, 1.0, 1.0, 2.0])
        force = ("time", "axis"), np.ones((4, 3)), {"units": "N"}
        time_ = "time", twice, {"units": "s"}
        axes = {"time": time_, "axis": list("xyz")}
        written(xr.Dataset({"force": force}, axes), file)
    with pytest.warns(TtusWarning, match="1 row equal to the row before left out"):
        found = read_wrenches(file)
    np.testing.assert_array_equal(found.time, [0.0, 1.0, 2.0])
