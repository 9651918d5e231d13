"""A box that crops a scan to the patient, so that a whole room may be read."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arguments import expect_one_of
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import FileError, GeometryError, InputError, warn
from ttus_opt.scan.pcd import read_pcd, truncated
from ttus_opt.scan.room import LARGEST_ROOM, ROOM, alone_in_room
from ttus_opt.scan.xyz import read_xyz


def inside(cloud: Array, box: Sequence[float]) -> NDArray[np.bool_]:
    """Which points of a scan are inside a box.

    Args:
        cloud: Scan, shape (n, 3) [m].
        box: xmin, xmax, ymin, ymax, zmin, zmax, in the scan's frame [m]; infinite
            on an open side.

    Returns:
        A mask, shape (n,).

    Raises:
        InputError: Not six numbers, a lower limit that is not below the upper, or no
            point inside; the message gives the extent of the points.

    Examples:
        >>> inside(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]), [-1, 1, -1, 1, -1, 1])
        array([ True, False])
    """
    limits = np.asarray(box, dtype=np.float64)
    if limits.shape != (6,) or np.isnan(limits).any():
        given = ",".join(map(str, box))
        raise InputError(f"a box is xmin,xmax,ymin,ymax,zmin,zmax [m], got {given}")
    low, high = limits[::2], limits[1::2]
    for axis, a, b in zip("xyz", low, high, strict=True):
        if not a < b:
            raise InputError(
                f"the box has {axis}min {a:g} and {axis}max {b:g}: the minimum must "
                "be smaller"
            )
    within = ((cloud >= low) & (cloud <= high)).all(axis=1)
    if not within.any():
        raise InputError(
            f"no point lies in the box: the scan reaches {extent_words(cloud)} m: give "
            "the box in metres, in the scan's frame"
        )
    return np.asarray(within)


def extent_words(cloud: Array) -> str:
    """The extent of points (n, 3) along each axis, as text."""
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    return ", ".join(
        f"{axis} {_length(a)} to {_length(b)}"
        for axis, a, b in zip("xyz", low.tolist(), high.tolist(), strict=True)
    )


def _length(value: float) -> str:
    return f"{value:.3f}" if abs(value) < 1e6 else f"{value:.4g}"


Unit = Literal["m", "cm", "mm"]

#: Metres per unit.
UNITS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
#: Least and largest plausible extent of a scan of a torso [m].
EXTENT_LIMITS = (0.1, 3.0)


def read_cloud(
    path: str | os.PathLike[str],
    *,
    unit: Unit | None = None,
    drop_nan: bool = False,
    box: Sequence[float] | None = None,
) -> Array:
    """Read a point cloud.

    Args:
        path: A .ply, .pcd, .xyz, .csv, .txt, .pts, .asc or .npy file. Text has x, y
            and z first, or a line that names the columns; colours, normals and
            intensities are ignored (`ttus_opt.scan.xyz`).
        unit: Unit of the file's coordinates; by default metres.
        drop_nan: Leave out points with NaN or infinite coordinates (cameras write them
            where they saw nothing) instead of refusing the file.
        box: xmin, xmax, ymin, ymax, zmin, zmax in the scan's frame [m], to crop a room.
            By default everything, or in a room the body that stands alone.

    Returns:
        Points in the scan's frame, shape (n, 3) [m].

    Raises:
        FileError: Missing, empty, truncated, of unknown kind, or wrong columns.
        InputError: An unknown unit, coordinates that are not finite, an extent that is
            implausible for a torso, or a box without points.
    """
    if unit is not None:
        expect_one_of(unit, UNITS, "unit")
    file = io.existing_file(path, "point cloud")
    suffix = file.suffix.lower()
    if suffix not in READERS:
        raise FileError(
            f"{file} has the suffix {suffix!r}, expected one of {', '.join(READERS)}: "
            "export it as one of these"
        )
    points = READERS[suffix](file)
    if len(points) == 0:
        raise FileError(f"{file} holds no points: record or export it again")
    finite = np.isfinite(points).all(axis=1)
    n_bad = int((~finite).sum())
    if n_bad == len(points):
        raise InputError(f"{file}: no point has finite coordinates: record it again")
    if n_bad and not drop_nan:
        raise InputError(
            f"{file}: {n_bad} of {len(points)} points have NaN or infinite "
            "coordinates: pass drop_nan=True to leave them out"
        )
    points = points[finite] * UNITS[unit or "m"]
    points = points[of_patient(points, file.name, box)]
    _check_extent(file, float(np.ptp(points, axis=0).max()) / UNITS[unit or "m"], unit)
    return np.ascontiguousarray(points)


def of_patient(points: Array, name: str, box: Sequence[float] | None = None) -> Mask:
    """Which points of a scan (n, 3) [m] are kept, shape (n,).

    Those inside the box, or in a room those of the body that stands alone; what is left
    out is told. Where none stands alone, a scan that a torso's limits allow is kept
    whole.

    Args:
        points: In metres.
        name: Of the scan, for messages.
        box: As in `read_cloud`.

    Raises:
        InputError: None stands alone, and the scan is larger; or a box without points.
    """
    if box is not None:
        return inside(points, box)
    extent = float(np.ptp(points, axis=0).max())
    if not ROOM < extent < LARGEST_ROOM:
        return np.ones(len(points), bool)
    try:
        kept = alone_in_room(points)
    except GeometryError as error:
        if extent > EXTENT_LIMITS[1]:
            raise InputError(f"{name}: {error}") from error
        warn(f"{name} is read whole: {error}", 2)
        return np.ones(len(points), bool)
    size = " x ".join(f"{edge:.2f}" for edge in np.ptp(points[kept], axis=0))
    warn(
        f"{name} shows a room: only the body that stands alone is read, {size} m, "
        f"{int(kept.sum()):,} of {len(points):,} points (box=… to take another part)",
        2,
    )
    return kept


def _check_extent(file: Path, extent: float, unit: Unit | None) -> None:
    """Refuse an extent [the file's unit] that is implausible for a torso."""
    least, largest = EXTENT_LIMITS
    assumed = unit or "m"
    if least <= extent * UNITS[assumed] <= largest:
        return
    better = [
        name for name, scale in UNITS.items() if least <= extent * scale <= largest
    ]
    if better:
        names = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}
        advice = f"are these {names[better[-1]]}? pass unit='{better[-1]}'"
    else:
        advice = (
            f"a torso has {least:g} to {largest:g} m: check its unit, or crop a room "
            "to the patient by box=xmin,xmax,ymin,ymax,zmin,zmax"
        )
    how = "" if unit is None else f" read with unit='{unit}'"
    raise InputError(
        f"{file}: largest coordinate extent is {extent:.4g}{how}: {advice}"
    )


def _read_ply(file: Path) -> Array:
    import trimesh

    with file.open("rb") as stream:
        head = stream.read(100_000)
    if not head.startswith(b"ply"):
        raise FileError(f"{file} does not begin with 'ply': not a PLY file?")
    announced = 0
    for line in head.split(b"end_header")[0].splitlines():
        words = line.split()
        if words[:2] == [b"element", b"vertex"] and len(words) == 3:
            # no file has that many bytes
            announced = int(words[2]) if re.fullmatch(rb"\d{1,15}", words[2]) else 0
    if announced == 0:
        raise FileError(
            f"the header of {file} declares no vertices: record or export it again"
        )
    if announced > file.stat().st_size:
        raise FileError(
            f"{file} is truncated: its header announces {announced} points, it has "
            f"{file.stat().st_size} bytes: record or copy it again"
        )
    try:
        with file.open("rb") as stream:
            loaded = trimesh.load(stream, file_type="ply", process=False)
        points = np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3)
    except Exception as error:  # trimesh raises nearly every class on damaged files
        raise FileError(
            f"{file} cannot be read as PLY ({type(error).__name__}): its header "
            f"announces {announced} points, truncated or damaged? export it again"
        ) from error
    if len(points) != announced:
        raise truncated(file, announced, len(points))
    return points


def _read_npy(file: Path) -> Array:
    points = io.read_npy(file).astype(np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        hint = "transposed?" if points.shape[:1] == (3,) else "save x, y, z columns"
        raise FileError(f"{file}: points must be (n, 3), got {points.shape}: {hint}")
    return points


#: What reads a cloud, by its suffix
READERS = {
    ".ply": _read_ply,
    ".pcd": read_pcd,
    **dict.fromkeys((".xyz", ".csv", ".txt", ".pts", ".asc"), read_xyz),
    ".npy": _read_npy,
}
