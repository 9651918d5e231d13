"""A camera's intrinsics, as OpenCV, ROS, Open3D and RealSense write them.

JSON, YAML or XML with the matrix as ``camera_matrix`` or ``K``/``k`` (nine numbers,
three rows, or a mapping with ``data``), as Open3D's ``intrinsic_matrix`` (nine numbers
column by column), or as ``fx``, ``fy``, ``ppx``, ``ppy`` (``cx``, ``cy``); the
distortion as ``distortion_coefficients``, ``D``/``d`` or ``coeffs`` (OpenCV's order
k1, k2, p1, p2, k3, …; none where absent), and the size as ``image_width``/``width`` and
``image_height``/``height``. A ``.bag`` of RealSense's SDK or of ROS has its own.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError, located
from ttus_opt.sensors.depth_bag import SUFFIX, read_bag_camera_info
from ttus_opt.sensors.mapping_file import read_mapping

#: Numbers of distortion coefficients that OpenCV knows
DISTORTIONS = (0, 4, 5, 8, 12, 14)

#: Larger focal lengths and sizes are refused [pixel]
LARGEST = 1e5

# without underscores, in lower case
MATRIX = ("cameramatrix", "k", "matrix")
COLUMNS = ("intrinsicmatrix",)
DISTORTION = (*("distortioncoefficients", "d", "distcoeffs", "distortion", "coeffs"),)
WIDTH, HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
NUMBERS = (("fx",), ("fy",), ("ppx", "cx"), ("ppy", "cy"))

#: Names of a mapping within which some programs write it
WITHIN = ("intrinsic", "intrinsics", "depthintrinsics", "depth")

#: Names of OpenCV's distortion models, and of one that is its inverse
MODELS = ("plumbbob", "rationalpolynomial", "brownconrady", "none", "")
INVERSE = ("inversebrownconrady", "modifiedbrownconrady")


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera with OpenCV's distortion.

    Attributes:
        matrix: K, shape (3, 3) [pixel].
        distortion: k1, k2, p1, p2, k3, …, shape (0 to 14,) [–].
        size: Width and height of its images [pixel]; None where unknown.
    """

    matrix: Array
    distortion: Array
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        """Validate the intrinsics.

        Raises:
            InputError: An invalid camera matrix or number of coefficients.
        """
        K = self.matrix
        if K.shape != (3, 3):
            raise InputError(f"a camera matrix is (3, 3), got {K.shape}")
        if not (np.isfinite(K).all() and np.abs(K).max() < LARGEST):
            raise InputError(
                f"a camera matrix has finite numbers below {LARGEST:g} pixel: export "
                "the calibration again"
            )
        if not (K[0, 0] > 1 and K[1, 1] > 1):
            raise InputError(
                "a camera matrix has focal lengths above 1 pixel on its diagonal, got "
                f"{K[0, 0]:g} and {K[1, 1]:g}: is it normalised? Multiply by the width"
            )
        if K[1, 0] != 0 or K[2, 0] != 0 or K[2, 1] != 0 or K[2, 2] != 1:
            raise InputError(
                "a camera matrix has rows (fx, s, cx), (0, fy, cy), (0, 0, 1): "
                "transposed, or in another order?"
            )
        if self.distortion.shape not in [(n,) for n in DISTORTIONS]:
            raise InputError(
                f"distortion has {', '.join(map(str, DISTORTIONS))} coefficients, got "
                f"shape {self.distortion.shape}"
            )
        if not (
            np.isfinite(self.distortion).all()
            and np.abs(self.distortion).max(initial=0.0) < LARGEST
        ):
            raise InputError("distortion coefficients must be finite")

    def check_shape(self, shape: tuple[int, ...]) -> None:
        """Validate the height and width of an image [pixel].

        Raises:
            InputError: The camera's images have another size.
        """
        found = (shape[1], shape[0])
        if self.size is not None and found != self.size:
            raise InputError(
                f"the image has {found[0]} x {found[1]} pixels, the intrinsics are for "
                f"{self.size[0]} x {self.size[1]}: scale one of them"
            )


def read_intrinsics(
    path: str | os.PathLike[str], topic: str | None = None
) -> Intrinsics:
    """Intrinsics from JSON, YAML, XML or a recording, whoever wrote them.

    Args:
        path: The file; YAML and .bag need the extra ``sensors``.
        topic: Name of a recording's depth images, where there are several.

    Raises:
        FileError: It is missing, damaged, or holds no intrinsics.
        MissingPackageError: PyYAML is not installed.
    """
    if Path(path).suffix.lower() == SUFFIX:
        file = io.existing_file(path, "camera")
        found: Mapping[str, Any] = read_bag_camera_info(file, topic)
    else:
        found = read_mapping(path, "camera calibration")
    with located(os.fspath(path), FileError):
        try:
            return _from_mapping(found)
        except InputError:
            raise
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(
                "the camera matrix, its distortion or size are not numbers: export "
                "the calibration again"
            ) from error


def _from_mapping(given: Mapping[str, Any]) -> Intrinsics:
    found = {
        str(k).lower().replace("_", "").replace(" ", ""): v for k, v in given.items()
    }
    inner = _first(found, WITHIN)
    if isinstance(inner, Mapping) and _matrix(found) is None:
        return _from_mapping(inner)
    matrix = _matrix(found)
    if matrix is None or matrix.size != 9:
        raise InputError(
            "a camera matrix of nine numbers (camera_matrix, K, intrinsic_matrix) or "
            "fx, fy, ppx, ppy is expected: give the calibration's file"
        )
    distortion = _numbers(found, DISTORTION)
    sides = [_first(found, names) for names in (WIDTH, HEIGHT)]
    size = None
    if None not in sides:
        size = (int(sides[0]), int(sides[1]))
        if not all(0 < side < LARGEST for side in size):
            raise InputError(f"invalid image size: {size[0]} x {size[1]} pixels")
    model = str(_first(found, ("distortionmodel", "model")) or "")
    word = model.rpartition(".")[2].lower().replace("_", "").replace(" ", "")
    word = word.removeprefix("distortion")
    straight = distortion is None or not distortion.any()
    if word not in MODELS and not (straight and word in INVERSE):
        raise InputError(
            f"distortion model {model} is not known: undistort the images, or "
            "calibrate with plumb_bob or rational_polynomial"
        )
    return Intrinsics(
        matrix.reshape(3, 3), np.zeros(0) if distortion is None else distortion, size
    )


def _matrix(found: Mapping[str, Any]) -> Array | None:
    """The camera matrix, flat; None without one."""
    by_columns = _numbers(found, COLUMNS)
    if by_columns is not None and by_columns.size == 9:
        nested = np.ndim(_first(found, COLUMNS)) == 2  # rows, as one writes by hand
        return by_columns if nested else by_columns.reshape(3, 3).T.reshape(-1)
    if (matrix := _numbers(found, MATRIX)) is not None:
        return matrix
    values = [_first(found, names) for names in NUMBERS]
    if None in values:
        return None
    fx, fy, cx, cy = map(float, values)
    return np.array([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0])


def _first(found: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    """The value of the first name present; None without one."""
    return next((found[name] for name in names if name in found), None)


def _numbers(found: Mapping[str, Any], names: tuple[str, ...]) -> Array | None:
    """A list, rows or OpenCV's mapping as a flat array; None where absent."""
    value = _first(found, names)
    if value is None:
        return None
    if isinstance(value, Mapping):
        value = value.get("data", [])
    return np.asarray(value, dtype=np.float64).reshape(-1)
