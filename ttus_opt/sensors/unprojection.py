"""The ray of every pixel of a camera.

From intrinsics, with OpenCV's distortion undone by iteration and checked by distorting
again; or from the manufacturer's table (time-of-flight headsets). Axes are OpenCV's: x
to the right of the image, y down, z forward.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError, located
from ttus_opt.sensors.intrinsics import Intrinsics

#: Largest error of a ray after distorting again [pixel]
MISS = 0.05

#: Least z of a unit ray: 87° off the axis
LEAST_Z = 0.05


@dataclass(frozen=True)
class Unprojection:
    """Rays of a camera's pixels.

    Attributes:
        rays: Unit vectors, camera axes, NaN where a pixel has none, shape
            (height, width, 3) [–].
    """

    rays: Array = field(repr=False)

    def __post_init__(self) -> None:
        """Validate the rays.

        Raises:
            InputError: Another shape, or rays that are not unit vectors.
        """
        if self.rays.ndim != 3 or self.rays.shape[2] != 3:
            raise InputError(
                f"rays must be (height, width, 3), got {self.rays.shape}: transposed?"
            )
        length = np.linalg.norm(self.rays, axis=2)
        if not (np.abs(length[np.isfinite(length)] - 1.0) < 1e-6).all():
            raise InputError("rays must be unit vectors: divide by their length")
        if not np.isfinite(length).any():
            raise InputError("no pixel has a ray: check the intrinsics or the table")

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width [pixel]."""
        return self.rays.shape[0], self.rays.shape[1]

    @property
    def focal(self) -> float:
        """Focal length, the median over the image [pixel]."""
        x = self.rays[..., 0] / self.rays[..., 2]
        y = self.rays[..., 1] / self.rays[..., 2]
        steps = np.hypot(np.diff(x, axis=1)[:-1], np.diff(y, axis=1)[:-1])
        return 1.0 / float(np.nanmedian(steps))

    @classmethod
    def from_intrinsics(
        cls, camera: Intrinsics, shape: tuple[int, int]
    ) -> Unprojection:
        """Rays of a pinhole camera, NaN where its distortion cannot be undone.

        Args:
            camera: Its intrinsics.
            shape: Height and width of the image [pixel].

        Raises:
            InputError: The intrinsics are for another size, or give no ray at all.
        """
        import cv2

        camera.check_shape(shape)
        v, u = np.indices(shape, dtype=np.float64)
        pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
        flat = cv2.undistortPointsIter(
            pixels, camera.matrix, camera.distortion, np.eye(3), np.eye(3), stop
        ).reshape(-1, 2)
        rays = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
        with np.errstate(invalid="ignore", over="ignore"):
            again, _ = cv2.projectPoints(
                rays, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion
            )
            miss = np.linalg.norm(again.reshape(-1, 2) - pixels[:, 0], axis=1)
        return cls(_unit(np.where((miss < MISS)[:, None], rays, np.nan), shape))


def read_unprojection(path: str | os.PathLike[str]) -> Unprojection:
    """Rays from a table.

    Args:
        path: NPY of shape (height, width, 3), directions of any length; or (height,
            width, 2), their x and y at z = 1. NaN or zeros where a pixel has no ray.

    Raises:
        FileError: Missing, damaged, or not such a table.
    """
    file = io.existing_file(path, "unprojection table")
    if file.suffix.lower() != ".npy":
        raise FileError(f"{file}: an unprojection table is a NPY array: save it so")
    values = io.read_npy(file)
    if values.ndim != 3 or values.shape[2] not in (2, 3):
        raise FileError(
            f"{file}: an unprojection table is (height, width, 3) or (height, width, "
            f"2), got {values.shape}: transposed?"
        )
    rows = values.reshape(-1, values.shape[2]).astype(np.float64)
    if rows.shape[1] == 2:
        rows = np.concatenate([rows, np.ones((len(rows), 1))], axis=1)
    behind = rows[:, 2] < 0.0
    if behind.mean() > 0.5:
        raise FileError(
            f"{file}: most rays look along -z, expected x right, y down, z forward: "
            "negate y and z"
        )
    with located(file, FileError):
        return Unprojection(_unit(rows, values.shape[:2]))


def _unit(directions: Array, shape: tuple[int, ...]) -> Array:
    """Directions (n, 3) as unit rays (height, width, 3), NaN where invalid."""
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        rays = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        sees = rays[:, 2] >= LEAST_Z
    return np.asarray(np.where(sees[:, None], rays, np.nan)).reshape(*shape, 3)
