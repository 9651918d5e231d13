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
from typing import Any, NamedTuple

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError, located
from ttus_opt.core.io import shortened
from ttus_opt.core.netcdf_file import Variable
from ttus_opt.probe.column_names import UNITS, factor
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.sensors.column_map import ORDER, ORDERS
from ttus_opt.sensors.stream_format import StreamFormat, Wanted
from ttus_opt.sensors.streams import WrenchStream


def _read(path: Path, wanted: Wanted) -> list[RawRecording]:
    """The file's one stream."""
    names = wanted.columns
    single = [name for name in names if name not in ("t", ORDER, *UNITS)]
    if single:
        raise FileError(
            f"{path}: netCDF holds whole vectors: map position, quaternion, force or "
            f"torque, not {single[0]}"
        )
    content, _ = io.content_of(path, "netCDF stream")
    data = _File(content.variables, names)
    if "time" not in data.variables and not names and "radius" in data.variables:
        raise FileError(
            f"{path} holds a surface or a field, no poses or wrenches: wrong file?"
        )
    there = {k for k in UNITS if names.get(k, k) in data.variables}
    poses = wanted.kind in ("poses", "recording") or (
        not wanted.kind and "position" in there
    )
    forces = wanted.kind == "wrenches" or (wanted.kind != "poses" and "force" in there)
    vectors: dict[str, Array] = {}
    with located(path, FileError):
        time = data.time()
        if poses or not forces:
            vectors["position"] = data.vector("position", "xyz")
            order = data.order()
            quaternion = data.vector("quaternion", order)
            back = [order.index(axis) for axis in "wxyz"]
            vectors["quaternion"] = quaternion[:, back]
        if forces:
            vectors["force"] = data.vector("force", "xyz")
            if "torque" in there:
                vectors["torque"] = data.vector("torque", "xyz")
    note = "those of the variables' attributes, no frame stated"
    raw = RawRecording(str(path), time, notes=(note,), units_stated=True)
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


class _File(NamedTuple):
    """A file's variables, and its names by the package's."""

    variables: Mapping[str, Variable]
    names: Mapping[str, str]

    def find(self, name: str) -> tuple[str, Variable]:
        """A variable by the package's name, and the file's name."""
        ours = "t" if name == "time" else name
        theirs = self.names.get(ours, name)
        if theirs not in self.variables:
            known = ", ".join(self.variables) or "none"
            raise InputError(
                f"it has no variable {theirs}, but {known}: map them by columns, for "
                f"instance {ours}=…"
            )
        return theirs, self.variables[theirs]

    def in_si(self, name: str) -> Array:
        """A variable's numbers in SI units; in "seconds since …" by Unix time."""
        theirs, found = self.find(name)
        given = found.attrs.get("units", "1" if name == "quaternion" else None)
        word, _, origin = str(given).partition(" since ")
        scale = factor(name, word)
        if given is None or scale is None:
            raise InputError(
                f"{theirs} has units {given!r}, expected {' or '.join(UNITS[name])}: "
                "set the attribute units"
            )
        if found.values.dtype.kind not in "fiu":
            raise InputError(f"{theirs} does not hold numbers: wrong variable?")
        return np.asarray(scale * found.values.astype(np.float64) + _unix(origin))

    def time(self) -> Array:
        """Times [s]."""
        theirs, found = self.find("time")
        if len(found.dims) != 1:
            raise InputError(
                f"{theirs} has {len(found.dims)} dimensions, expected one for times"
            )
        return self.in_si("time")

    def vector(self, name: str, order: str) -> Array:
        """A vector over time, shape (T, len(order))."""
        theirs, found = self.find(name)
        along, shape = self.find("time")[1].dims, found.values.shape
        if len(shape) != 2 or found.dims[:1] != along or shape[1] != len(order):
            pairs = zip(found.dims, shape, strict=True)
            sizes = ", ".join(f"{d} {n}" for d, n in pairs) or "none"
            raise InputError(
                f"{theirs} must have dimensions ({', '.join(along)}, {len(order)} "
                f"components), got ({sizes}): transpose it"
            )
        labels = self.labels(found)
        if labels and labels != order:
            raise InputError(
                f"components of {theirs} are {', '.join(labels)}, expected "
                f"{', '.join(order)}: reorder them"
            )
        return self.in_si(name)

    def labels(self, found: Variable) -> str:
        """Labels of components as one word (``qw`` counts as w), empty without any."""
        coordinate = self.variables.get(found.dims[-1]) if found.dims[1:] else None
        if coordinate is None or coordinate.values.dtype.kind not in "US":
            return ""
        if coordinate.dims != found.dims[-1:]:
            return ""
        words = (str(label).strip().lower() for label in coordinate.values.astype(str))
        return "".join(word[-1:] for word in words)

    def order(self) -> str:
        """Its order, from the labels, the attribute or the column map."""
        theirs, found = self.find("quaternion")
        stated = str(found.attrs.get("order", ""))
        said = {self.labels(found), stated, self.names.get(ORDER, "")} - {""}
        if len(said) > 1 or not said <= set(ORDERS):
            raise InputError(
                f"the order of {theirs} is given as {' and '.join(sorted(said))}: "
                "expected wxyz or xyzw"
            )
        if not said:
            raise InputError(
                f"the order of {theirs} is not stated and never guessed: give columns "
                f"{ORDER}=xyzw or wxyz, or label the components"
            )
        return said.pop()


def _unix(origin: str) -> float:
    """Unix time of an origin of times, 0 for none [s]: files of one clock keep it."""
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


NETCDF = StreamFormat(
    "netCDF",
    lambda file, head: file.suffix.lower() in (".nc", ".nc4", ".cdf"),
    _read,
    has_columns=True,
)
