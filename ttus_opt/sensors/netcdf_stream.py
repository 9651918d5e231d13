"""Pose and wrench streams in netCDF.

A one-dimensional variable ``time``, and ``position(time, 3)``, ``quaternion(time, 4)``,
``force(time, 3)`` and ``torque(time, 3)``, each with ``units``. Components are labelled
by a coordinate (``x, y, z`` or ``w, x, y, z``); an unlabelled quaternion has an
attribute ``order``.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError, located
from ttus_opt.core.io import shortened
from ttus_opt.probe.column_names import UNITS
from ttus_opt.probe.column_names import factor as factor_to_si
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.sensors.column_map import ORDER, ORDERS
from ttus_opt.sensors.netcdf_child import read_apart
from ttus_opt.sensors.stream_format import StreamFormat, Wanted
from ttus_opt.sensors.streams import WrenchStream

if TYPE_CHECKING:
    import xarray as xr


def _read(path: Path, wanted: Wanted) -> list[RawRecording]:
    """The file's one stream.

    Raises:
        FileError: Missing, damaged, or without such variables, units or order.
    """
    file, data, names = _opened(path, wanted.columns)
    if "time" not in data.variables and not names and "radius" in data.variables:
        raise FileError(
            f"{file} holds a surface or a field, no poses or wrenches: wrong file?"
        )
    there = {k for k in UNITS if names.get(k, k) in data.variables}
    poses = wanted.kind in ("poses", "recording") or (
        not wanted.kind and "position" in there
    )
    forces = wanted.kind == "wrenches" or (wanted.kind != "poses" and "force" in there)
    vectors: dict[str, Array] = {}
    with located(file, FileError):
        time = _time(data, names)
        if poses or not forces:
            vectors["position"] = _vector(data, "position", names, "xyz")
            order = _order(data, names)
            quaternion = _vector(data, "quaternion", names, order)
            back = [order.index(axis) for axis in "wxyz"]
            vectors["quaternion"] = quaternion[:, back]
        if forces:
            vectors["force"] = _vector(data, "force", names, "xyz")
            if "torque" in there:
                vectors["torque"] = _vector(data, "torque", names, "xyz")
    note = "those of the variables' attributes, no frame stated"
    raw = RawRecording(str(file), time, notes=(note,), units_stated=True)
    return [raw.replaced(**vectors)]


def write_netcdf_wrenches(stream: WrenchStream, path: str | os.PathLike[str]) -> None:
    """Write wrenches as a netCDF stream.

    Raises:
        FileError: The file cannot be written.
    """
    import xarray as xr

    variables: dict[str, Any] = {
        "force": (("time", "axis"), stream.force, {"units": "N"})
    }
    if stream.torque is not None:
        variables["torque"] = (("time", "axis"), stream.torque, {"units": "N m"})
    time = ("time", stream.time, {"units": "s", "axis": "T"})
    dataset = xr.Dataset(variables, {"time": time, "axis": list("xyz")})
    io.write_dataset(dataset, path, kind="wrenches", version=1)


def _opened(
    path: str | os.PathLike[str], columns: Mapping[str, str] | None
) -> tuple[Path, xr.Dataset, Mapping[str, str]]:
    """The file, its content in memory, and its names by the package's.

    Raises:
        FileError: Missing, damaged, not netCDF, or a map that names single components.
    """
    import xarray as xr

    file, _ = io.whole_file(path, "netCDF stream")
    names = columns or {}
    single = [name for name in names if name not in ("t", ORDER, *UNITS)]
    if single:
        raise FileError(
            f"{file}: netCDF holds whole vectors: map position, quaternion, force or "
            f"torque, not {single[0]}"
        )
    try:
        # xarray makes a variable with the name of its dimension a coordinate
        found = {name: tuple(each) for name, each in read_apart(file).items()}
        return file, xr.Dataset(found), names
    except Exception as error:  # damaged files raise nearly every class
        raise FileError(
            f"{file} is not a readable netCDF file: copy or record it again"
        ) from error


def _variable(data: xr.Dataset, name: str, names: Mapping[str, str]) -> xr.DataArray:
    """A variable by the package's name.

    Raises:
        InputError: The file does not have it.
    """
    theirs = names.get("t" if name == "time" else name, name)
    if theirs not in data.variables:
        known = ", ".join(map(str, data.variables)) or "none"
        raise InputError(
            f"it has no variable {theirs}, but {known}: map them by columns, for "
            f"instance {'t' if name == 'time' else name}=…"
        )
    return data[theirs]


def _factor(found: xr.DataArray, name: str, unit: str | None = None) -> float:
    """Factor from a variable's unit to SI.

    Raises:
        InputError: No unit, or an unknown one.
    """
    given = found.attrs.get("units") if unit is None else unit
    if given is None and name == "quaternion":
        return 1.0
    word = str(given).strip()
    known = UNITS[name]
    factor = factor_to_si(name, word)
    if given is None or factor is None:
        raise InputError(
            f"{found.name} has units {given!r}, expected {' or '.join(known)}: set the "
            "attribute units"
        )
    return factor


def _numbers(found: xr.DataArray) -> Array:
    """Values in double precision.

    Raises:
        InputError: They are not numbers.
    """
    if found.dtype.kind not in "fiu":
        raise InputError(f"{found.name} does not hold numbers: wrong variable?")
    return np.asarray(found.to_numpy(), dtype=np.float64)


def _time(data: xr.Dataset, names: Mapping[str, str]) -> Array:
    """Times [s]; in "seconds since …" the epoch is ignored.

    Raises:
        InputError: Not one dimension, or no unit.
    """
    found = _variable(data, "time", names)
    if found.ndim != 1:
        raise InputError(
            f"{found.name} has {found.ndim} dimensions, expected one for times"
        )
    unit, _, origin = str(found.attrs.get("units", "")).partition(" since ")
    return _factor(found, "time", unit) * _numbers(found) + _unix(origin)


def _unix(origin: str) -> float:
    """Unix time of an origin of times, 0 for none [s]: files of one clock keep it.

    Raises:
        InputError: Not a date and time.
    """
    if not origin:
        return 0.0
    try:
        date = datetime.fromisoformat(origin.strip().removesuffix("UTC").strip())
    except ValueError as error:
        raise InputError(
            f"times are since {shortened(origin)}: write it as 2026-01-31 12:00:00"
        ) from error
    if date.tzinfo is None:
        date = date.replace(tzinfo=UTC)
    return date.timestamp()


def _vector(data: xr.Dataset, name: str, names: Mapping[str, str], order: str) -> Array:
    """A vector over time, shape (T, len(order)).

    Raises:
        InputError: Other dimensions, components in another order, or another unit.
    """
    found = _variable(data, name, names)
    along = _variable(data, "time", names).dims
    if found.ndim != 2 or found.dims[:1] != along or found.shape[1] != len(order):
        sizes = ", ".join(f"{d} {n}" for d, n in found.sizes.items()) or "none"
        raise InputError(
            f"{found.name} must have dimensions ({', '.join(map(str, along))}, "
            f"{len(order)} components), got ({sizes}): transpose it"
        )
    labels = _labels(found)
    if labels and labels != order:
        raise InputError(
            f"components of {found.name} are {', '.join(labels)}, expected "
            f"{', '.join(order)}: reorder them"
        )
    return _factor(found, name) * _numbers(found)


def _labels(found: xr.DataArray) -> str:
    """Component labels as one word (``qw`` counts as w); empty where there are none."""
    dim = found.dims[-1]
    if dim not in found.coords or found.coords[dim].dtype.kind not in "UOS":
        return ""
    words = [str(label).strip().lower() for label in found.coords[dim].to_numpy()]
    return "".join(word[-1:] for word in words)


def _order(data: xr.Dataset, names: Mapping[str, str]) -> str:
    """The order of a quaternion, from its labels, its attribute or the column map.

    Raises:
        InputError: None of these states it, or two differ.
    """
    found = _variable(data, "quaternion", names)
    labelled = _labels(found) if found.ndim == 2 else ""
    named = (labelled, str(found.attrs.get("order", "")), names.get(ORDER, ""))
    said = {word for word in named if word}
    if len(said) > 1 or not said <= set(ORDERS):
        raise InputError(
            f"the order of {found.name} is given as {' and '.join(sorted(said))}: "
            "expected wxyz or xyzw"
        )
    if not said:
        raise InputError(
            f"the order of {found.name} is not stated and never guessed: give columns "
            f"{ORDER}=xyzw or wxyz, or label the components"
        )
    return said.pop()


NETCDF = StreamFormat(
    "netCDF",
    lambda file, head: file.suffix.lower() in (".nc", ".nc4", ".cdf"),
    _read,
    has_columns=True,
)
