"""The patient frame in the scan: origin, and z along the body's long inner axis."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.scan.frame_estimate import estimate_body_frame


@dataclass(frozen=True)
class Axis:
    """The patient frame: x_scan = rotation · x_patient + origin.

    Attributes:
        origin: Origin of the patient frame in the scan, shape (3,) [m].
        rotation: Columns are the patient frame's axes in the scan, z along the
            body, shape (3, 3) [–].
    """

    origin: Array
    rotation: Array

    def __post_init__(self) -> None:
        """Refuse what is not a rigid frame.

        Raises:
            InputError: Wrong shapes, or a matrix that is not a rotation.
        """
        if self.origin.shape != (3,) or self.rotation.shape != (3, 3):
            raise InputError(
                "an axis needs origin (3,) [m] and rotation (3, 3), got "
                f"{self.origin.shape} and {self.rotation.shape}"
            )
        error = np.abs(self.rotation.T @ self.rotation - np.eye(3)).max()
        if not (error < 1e-6 and np.linalg.det(self.rotation) > 0):
            raise InputError(
                "axis rotation is not a rotation matrix (orthonormal, determinant +1)"
            )

    @classmethod
    def identity(cls) -> Axis:
        """The scan's own frame."""
        return cls(np.zeros(3), np.eye(3))

    @classmethod
    def from_cloud(
        cls, cloud: Array, *, rng: np.random.Generator | None = None
    ) -> Axis:
        """Estimate the patient frame from a scan (`ttus_opt.scan.frame_estimate`).

        z runs along what stands above the supporting plane, x away from that plane
        (anterior), and the origin is inside the body.

        Args:
            cloud: Scan, shape (n, 3) [m].
            rng: Draws trial planes; a fixed seed when not given.

        Returns:
            The frame.

        Raises:
            InputError: The cloud is not (n, 3) or has fewer than 100 points.
            GeometryError: The scan shows no body.
        """
        frame = estimate_body_frame(cloud, rng=rng)
        return cls(frame.origin, frame.rotation)

    def to_patient(self, points: Array) -> Array:
        """Scan points (n, 3) [m] in the patient frame, shape (n, 3) [m]."""
        return np.asarray((points - self.origin) @ self.rotation)

    def to_scan(self, points: Array) -> Array:
        """Patient points (n, 3) [m] in the scan's frame, shape (n, 3) [m]."""
        return np.asarray(points @ self.rotation.T + self.origin)

    def attributes(self) -> dict[str, str]:
        """The frame as netCDF attributes (JSON)."""
        return {
            "axis_origin": json.dumps(self.origin.tolist()),
            "axis_rotation": json.dumps(self.rotation.tolist()),
        }

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, Any]) -> Axis:
        """Read what `attributes` wrote; the identity where a file has none."""
        if "axis_origin" not in attributes:
            return cls.identity()
        return cls(
            np.array(json.loads(attributes["axis_origin"]), dtype=float),
            np.array(json.loads(attributes["axis_rotation"]), dtype=float),
        )
