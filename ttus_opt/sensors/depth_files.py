"""Depth images as files: 16-bit PNG in millimetres, TIFF or NPY in metres.

Whole numbers are millimetres and fractions are metres, as cameras write them, unless a
unit is given. Implausible depths are refused here, because metres read as millimetres
would otherwise fail much later.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arguments import expect_one_of
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.scan.cloud import UNITS
from ttus_opt.sensors.depth_bag import SUFFIX, Frame, read_bag_depth
from ttus_opt.sensors.image_file import decoded

SUFFIXES = (".png", ".tif", ".tiff", ".npy")

#: Largest file [byte] and image [pixel]
LARGEST_FILE, LARGEST_IMAGE = 400_000_000, 30_000_000

#: Smallest side of an image [pixel]
LEAST_SIDE = 16

#: Plausible median depth of a scan [m]
DEPTH_LIMITS = (0.1, 10.0)


class PictureError(FileError):
    """An image whose pixels are colours or grey values, not depths."""


def read_depth(
    path: str | os.PathLike[str],
    unit: str | None = None,
    *,
    topic: str | None = None,
    at: float | None = None,
) -> tuple[Array, Frame | None]:
    """The depths of an image, and which it is.

    Args:
        path: A .png, .tif, .tiff or .npy file of one number per pixel, or a .bag of
            which one image is read in its own unit.
        unit: ``m``, ``cm`` or ``mm``; by default millimetres for whole numbers and
            metres for fractions.
        topic: Of a recording, as in `read_bag_depth`.
        at: Of a recording, as in `read_bag_depth` [s].

    Returns:
        Depths, NaN where not measured (0, negative, not finite, or the largest number
        of an integer type), shape (height, width) [m]; and which image of a recording,
        None for an image alone.

    Raises:
        FileError: Missing, damaged, not a depth image, or a recording of several
            topics.
        InputError: An unknown unit, depths that are implausible in it, or a time
            outside the recording.
    """
    if unit is not None:
        expect_one_of(unit, UNITS, "unit")
    if Path(path).suffix.lower() == SUFFIX:
        file = io.existing_file(path, "recording")
        pixels, frame = read_bag_depth(file, topic, at)
        return _in_metres(file, pixels, frame.unit), frame
    if topic is not None or at is not None:
        raise InputError(f"{path} is an image alone: leave name= and at= out")
    file = io.existing_file(path, "depth image", LARGEST_FILE)
    values = _read(file)
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    _check_kind(file, values)
    whole = values.dtype.kind in "iu"
    scale = UNITS[unit or ("mm" if whole else "m")]
    return _in_metres(file, values, scale), None


def _in_metres(file: Path, values: NDArray[Any], scale: float) -> Array:
    """Depths [m], NaN where nothing was measured; errors as `read_depth`."""
    whole = values.dtype.kind in "iu"
    with np.errstate(over="ignore", invalid="ignore"):
        depth = values.astype(np.float64) * scale
    lost = ~np.isfinite(depth) | (depth <= 0.0)
    if whole:
        lost |= values == np.iinfo(values.dtype).max
    _check_values(file, values, depth[~lost] / scale, scale)
    return np.where(lost, np.nan, depth)


def _read(file: Path) -> NDArray[Any]:
    suffix = file.suffix.lower()
    if suffix == ".npy":
        return io.read_npy(file)
    if suffix not in SUFFIXES:
        raise FileError(
            f"{file} has the suffix {suffix!r}, expected one of {', '.join(SUFFIXES)}: "
            "export the depth image as one of these"
        )
    import cv2

    return decoded(file, LARGEST_IMAGE, cv2.IMREAD_UNCHANGED)


def _check_kind(file: Path, values: NDArray[Any]) -> None:
    """Refuse colour or 8-bit pictures, and arrays that are not images."""
    if values.ndim != 2:
        wrong = f"{file}: a depth image is (height, width), got {values.shape}"
        if values.ndim == 3 and values.shape[2] in (3, 4):
            raise PictureError(
                f"{wrong}: a colour picture of the depth? export the depth itself"
            )
        raise FileError(f"{wrong}: save one number per pixel")
    if values.dtype.itemsize == 1:
        raise PictureError(
            f"{file} has 8 bits per pixel: a picture for the eye? export the depth "
            "itself, 16-bit PNG in millimetres"
        )
    if min(values.shape) < LEAST_SIDE or values.size > LARGEST_IMAGE:
        raise FileError(
            f"{file} has {values.shape[1]} x {values.shape[0]} pixels: a depth image "
            f"has {LEAST_SIDE} or more a side and at most {LARGEST_IMAGE // 10**6} "
            "million"
        )


def _check_values(file: Path, values: NDArray[Any], seen: Array, scale: float) -> None:
    """Refuse depths [the file's unit] that are implausible for a scan of a patient."""
    if len(seen) == 0:
        if (values < 0).any():
            raise InputError(
                f"{file}: every depth is negative: a camera that looks along -z? "
                "negate them"
            )
        raise InputError(
            f"{file}: no pixel has a depth: nothing within the camera's range? "
            "record it again"
        )
    least, largest = DEPTH_LIMITS
    middle = float(np.median(seen))
    if least <= middle * scale <= largest:
        return
    better = [u for u, size in UNITS.items() if least <= middle * size <= largest]
    # the best guess puts the camera about a metre away
    better.sort(key=lambda u: abs(np.log(middle * UNITS[u])))
    advice = (
        f"pass unit='{better[0]}'"
        if better
        else f"a scan has {least:g} to {largest:g} m: export the depth again, whole "
        "numbers in millimetres or fractions in metres"
    )
    raise InputError(
        f"{file}: the median depth is {middle:.4g}, {middle * scale:.4g} m as read: "
        f"another unit? {advice}"
    )
