"""The patient frame in the scan: origin, and z along the body's long inner axis.

`Axis` also keeps the supporting plane that the frame was estimated from, so that the
plane is found once in a scan.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.rigid_motion import homogeneous, inverse
from ttus_opt.scan.frame_estimate import estimate_frame
from ttus_opt.scan.supporting_plane import SupportingPlane, find_supporting_plane


@dataclass(frozen=True, eq=False)
class Axis:
    """The patient frame: x_scan = rotation · x_patient + origin.

    Attributes:
        origin: Origin of the patient frame in the scan, shape (3,) [m].
        rotation: Columns are the patient frame's axes in the scan, z along the
            body, shape (3, 3) [–].
        support: The plane the body lies on, in the scan's frame; None when the scan
            shows none; "unknown" for a frame that was given. Not written to files.
    """

    origin: Array
    rotation: Array
    support: SupportingPlane | Literal["unknown"] | None = field(
        default="unknown", compare=False, repr=False
    )

    def __post_init__(self) -> None:
        """Validate shapes, a finite origin and a rotation matrix."""
        if self.origin.shape != (3,) or self.rotation.shape != (3, 3):
            raise InputError(
                "an axis needs origin (3,) [m] and rotation (3, 3), got "
                f"{self.origin.shape} and {self.rotation.shape}"
            )
        if not np.isfinite(self.origin).all():
            raise InputError(f"axis origin must be finite [m], got {self.origin}")
        error = np.abs(self.rotation.T @ self.rotation - np.eye(3)).max()
        if not (error < 1e-6 and np.linalg.det(self.rotation) > 0):
            raise InputError(
                "axis rotation is not a rotation matrix (orthonormal, determinant +1)"
            )

    def __repr__(self) -> str:
        origin, z = (
            ", ".join(f"{v:.{digits}f}" for v in values)
            for values, digits in ((100 * self.origin, 1), (self.rotation[:, 2], 2))
        )
        return f"Axis(origin ({origin}) cm, z along ({z}) of the scan)"

    @classmethod
    def identity(cls) -> Axis:
        """The scan's own frame."""
        return cls(np.zeros(3), np.eye(3))

    @classmethod
    def from_cloud(
        cls,
        cloud: Array,
        *,
        head: ArrayLike | None = None,
        flip: bool = False,
        prone: bool = False,
        camera: ArrayLike | None = None,
        support: bool = True,
        rng: np.random.Generator | None = None,
    ) -> Axis:
        """Estimate the patient frame from a scan (`ttus_opt.scan.frame_estimate`).

        x points to the patient's right, y to the front, z to the head, and the origin
        is inside the body. The front is away from the supporting plane, or the side
        that the camera saw where there is none; the head is at the deeper end of the
        trunk (`ttus_opt.scan.body_sides`). The plane is kept in ``support``.

        Args:
            cloud: Scan, shape (n, 3) [m].
            head: Direction to the head in the scan, shape (3,); guessed when not given.
            flip: Take the opposite end for the head.
            prone: The patient lies on the front; without a support, the back was seen.
            camera: Where the scan was seen from, shape (3,) [m]; the scan's origin
                when not given and the scan looks like it (`frame_estimate.camera_of`).
            support: Look for the plane that the body lies on.
            rng: Draws trial planes; a fixed seed when not given.

        Returns:
            The frame. A `TtusWarning` says if head and feet are hardly distinguishable.

        Raises:
            InputError: The cloud is not (n, 3) or has fewer than 100 points, or a
                direction that is zero, or a camera at no place.
            GeometryError: The scan shows no body, or ``head`` points across it.
        """
        return cls(*estimate_frame(cloud, head, flip, prone, camera, support, rng))

    def supporting_plane(self, cloud: Array) -> SupportingPlane | None:
        """The stored plane; if unknown, the one found in the scan (n, 3) [m].

        Raises:
            InputError: The cloud is not (n, 3) or has fewer than 100 points.
        """
        if isinstance(self.support, str):
            return find_supporting_plane(cloud)
        return self.support

    @property
    def scan_to_patient(self) -> Array:
        """The rigid motion x_patient = R x_scan + t, shape (4, 4) [–, m]."""
        return inverse(homogeneous(self.rotation, self.origin))

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
        """Read what `attributes` wrote; the identity if a file has none.

        Raises:
            InputError: One of the two is missing, or not an array of numbers.
        """
        if not {"axis_origin", "axis_rotation"} & set(attributes):
            return cls.identity()
        return cls(
            _json_numbers(attributes, "axis_origin"),
            _json_numbers(attributes, "axis_rotation"),
        )


def _json_numbers(attributes: Mapping[str, Any], name: str) -> Array:
    """An attribute's array; `InputError` if it is not one."""
    given = attributes.get(name)
    try:
        if isinstance(given, str):
            return io.as_numbers(f"attribute {name}", json.loads(given))
    except json.JSONDecodeError:
        pass
    raise InputError(f"attribute {name} must be JSON text, like [0, 0, 0]")
