"""netCDF streams: dimensions, units and orders checked."""

from __future__ import annotations

import contextlib
import faulthandler
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from tests.hostile import only_our_errors
from ttus_opt.errors import FileError
from ttus_opt.sensors import netcdf_child, netcdf_stream
from ttus_opt.sensors.netcdf_child import Variable, packed, unpacked
from ttus_opt.sensors.netcdf_stream import (
    read_netcdf_poses,
    read_netcdf_wrenches,
    write_netcdf_wrenches,
)
from ttus_opt.sensors.stream_files import read_poses, read_wrenches
from ttus_opt.sensors.streams import WrenchStream

TIME = 100.0 + 0.05 * np.arange(8)
TURNS = Rotation.from_rotvec(np.outer(np.arange(8), [0.1, -0.05, 0.02]))
PLACE = np.outer(np.arange(8), [0.01, 0.02, -0.03])


def poses(order: str = "xyzw", labelled: bool = True) -> xr.Dataset:
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


def written(data: xr.Dataset, file: Path) -> Path:
    data.to_netcdf(file, engine="netcdf4")
    return file


def forked(file: Path) -> dict[str, Variable]:
    """`read_apart` in a copy of this process, for thousands of files."""
    back, there = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(back)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        faulthandler.disable()
        status = 1
        with contextlib.suppress(BaseException), os.fdopen(there, "wb") as stream:
            stream.write(packed(str(file)))
            status = 0
        os._exit(status)
    os.close(there)
    with os.fdopen(back, "rb") as stream:
        content = stream.read()
    if os.waitpid(child, 0)[1]:
        raise ValueError("its reader crashed")
    return unpacked(content)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    if hasattr(os, "fork"):
        monkeypatch.setattr(netcdf_stream, "read_apart", forked)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
def test_poses(tmp_path: Path, order: str) -> None:
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


@pytest.mark.usefixtures("quick")
def test_other_units_and_names(tmp_path: Path) -> None:
    data = poses().rename(position="tip", time="stamp")
    data["tip"] = (1e3 * data.tip).assign_attrs(units="mm")
    stamp = ("stamp", 1e3 * TIME, {"units": "milliseconds since 1970-01-01"})
    data = data.assign_coords(stamp=stamp)
    file = written(data, tmp_path / "p.nc")
    found = read_netcdf_poses(file, {"t": "stamp", "position": "tip"})
    np.testing.assert_allclose(found.time, TIME)
    np.testing.assert_allclose(found.position, PLACE)
    with pytest.raises(FileError, match=r"no variable time, but.*t=…"):
        read_netcdf_poses(file)


def test_wrenches_there_and_back(tmp_path: Path) -> None:
    stream = WrenchStream(TIME, PLACE + 1.0, PLACE - 2.0)
    write_netcdf_wrenches(stream, tmp_path / "w.nc")
    found = read_wrenches(tmp_path / "w.nc")
    np.testing.assert_array_equal(found.force, stream.force)
    assert found.torque is not None
    np.testing.assert_array_equal(found.torque, stream.torque)
    alone = WrenchStream(TIME, PLACE)
    write_netcdf_wrenches(alone, tmp_path / "f.nc")
    assert read_netcdf_wrenches(tmp_path / "f.nc").torque is None


def late(data: xr.Dataset) -> xr.Dataset:
    return data.assign_coords(time=("time", TIME[::-1].copy(), {"units": "s"}))


def gone(data: xr.Dataset) -> xr.Dataset:
    place = data.position.copy()
    place[3, 1] = np.nan
    return data.assign(position=place.assign_attrs(units="m"))


SPOILT: dict[str, Callable[[xr.Dataset], xr.Dataset]] = {
    "no order": lambda data: poses(labelled=False),
    "orders": lambda d: d.assign(quaternion=d.quaternion.assign_attrs(order="wxyz")),
    "no unit": lambda d: d.assign(position=d.position.drop_attrs(deep=False)),
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
        ("text", "no numbers"),
        ("gone", "NaN"),
        ("late", "increase"),
        ("long", "check units"),
    ],
)
def test_what_is_refused(tmp_path: Path, name: str, words: str) -> None:
    file = written(SPOILT[name](poses()), tmp_path / "p.nc")
    with pytest.raises(FileError, match=words) as told:
        read_netcdf_poses(file)
    assert "\n" not in str(told.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "p.nc").write_text("t,px,py,pz")
    with pytest.raises(FileError, match="not a readable netCDF"):
        read_netcdf_poses(tmp_path / "p.nc")
    with pytest.raises(FileError, match="whole vectors"):
        read_netcdf_poses(tmp_path / "p.nc", {"px": "x"})


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a system that can fork")
@pytest.mark.parametrize(
    "n", [20, pytest.param(3000, marks=[pytest.mark.slow, pytest.mark.long])]
)
@pytest.mark.usefixtures("quick")
def test_mutations(tmp_path: Path, n: int) -> None:
    """Some of these crash the netCDF library: in its own process alone."""
    sources = [written(poses(), tmp_path / "p.nc")]
    only_our_errors(sources, read_netcdf_poses, n)


def test_a_reader_that_crashes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "crash.py").write_text("import os\nos.abort()\n")
    monkeypatch.setattr(netcdf_child, "__file__", str(tmp_path / "crash.py"))
    file = written(poses(), tmp_path / "p.nc")
    with pytest.raises(FileError, match="not a readable netCDF"):
        read_netcdf_poses(file)
