"""Options about a scan and how the patient lies in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ttus_opt.cli.options import numbers
from ttus_opt.core.errors import GeometryError, InputError

if TYPE_CHECKING:
    from ttus_opt.core.arrays import Array
    from ttus_opt.scan.frame import Axis


@dataclass(frozen=True)
class CloudOptions:
    """The scan, as typed.

    Attributes:
        scans: A point cloud (PLY, PCD, XYZ, CSV, TXT, PTS or NPY), or one or more depth
            images (PNG, TIFF or NPY).
        unit: Unit of the scan's coordinates: m, cm or mm. By default m, or mm for
            depths in whole numbers.
        drop_nan: Leave out points that are NaN.
        box: Read only the points inside this box, in the scan's frame [m]; inf and -inf
            leave a side open.
    """

    scans: Annotated[list[Path], typer.Argument()]
    unit: str | None = None
    drop_nan: bool = False
    box: Annotated[
        str | None, typer.Option(metavar="xmin,xmax,ymin,ymax,zmin,zmax")
    ] = None

    def read(self) -> Array:
        """The points of a cloud in metres, shape (n, 3).

        Raises:
            FileError: The file is not a usable cloud.
            InputError: Several clouds; unit, box or coordinates that cannot be used.
        """
        from ttus_opt.scan.cloud import read_cloud

        if len(self.scans) > 1:
            raise InputError(
                f"got {len(self.scans)} point clouds, expected one: depth images need "
                "--intrinsics or --rays"
            )
        return read_cloud(
            self.scans[0],
            unit=self.unit,  # type: ignore[arg-type]  # checked there
            drop_nan=self.drop_nan,
            box=self.limits,
        )

    @property
    def limits(self) -> tuple[float, ...] | None:
        """The box as numbers [m]; None for everything.

        Raises:
            InputError: They are not six numbers.
        """
        return None if self.box is None else numbers(self.box, 6, "--box")


@dataclass(frozen=True)
class AxisOptions:
    """Where the patient's frame lies in the scan, as typed.

    Attributes:
        head: Direction to the head in the scan. By default the end where the trunk is
            deeper.
        flip_axis: Put the head at the other end than the one found.
        prone: The patient lies on the front.
        axis_origin: A point inside the body, x,y,z in the scan [m].
        axis_direction: Direction along the body to the head, x,y,z in the scan; needs
            --axis-origin.
        axis_from: Take the patient frame from this surface file (.nc), or from the
            poses of a probe held above the sternum, in the scan's frame (.csv).
        probe_axes: For such poses: which of the probe's axes (x, -x, y, -y, z, -z)
            point into the patient and to the head.
        axis_depth: For such poses: depth of the origin below the skin [m]. By default
            half-way to the plane the body lies on.
        support: Find the plane the body lies on and leave it out.
        seen_from: Where the camera was, x,y,z in the scan [m]. By default as --poses
            say, and for a cloud that looks like one view from its origin, there.
    """

    head: Annotated[str | None, typer.Option(metavar="x,y,z")] = None
    flip_axis: bool = False
    prone: bool = False
    axis_origin: str | None = None
    axis_direction: str | None = None
    axis_from: Path | None = None
    probe_axes: Annotated[str, typer.Option(metavar="INTO,HEAD")] = "z,-y"
    axis_depth: float | None = None
    support: Annotated[bool, typer.Option("--support/--no-support")] = True
    seen_from: Annotated[str | None, typer.Option(metavar="x,y,z")] = None

    @property
    def are_given(self) -> bool:
        """Whether anything says where the frame lies."""
        stated = (self.head, self.axis_from, self.axis_origin, self.axis_direction)
        return any(stated) or self.flip_axis or self.prone

    @property
    def guesses(self) -> bool:
        """Whether which end is the head is found in the scan."""
        stated = (self.head, self.axis_from, self.axis_direction)
        return not any(stated) and not self.flip_axis

    def frame(self, cloud: Array, camera: Array | None = None) -> Axis:
        """The patient frame: from a file, from origin and direction, or estimated.

        Args:
            cloud: The scan, shape (n, 3) [m].
            camera: Where it was seen from, shape (3,) [m]; None where unknown.

        Raises:
            InputError: Options that cannot be combined, or are not numbers.
            GeometryError: The scan shows no body.
        """
        from ttus_opt.scan.frame import Axis
        from ttus_opt.sensors.probe_axis import read_axis

        place: Any = camera
        if self.seen_from is not None:
            place = numbers(self.seen_from, 3, "--seen-from")
        given = self.axis_origin is not None or self.axis_direction is not None
        lying = self.head is not None or self.flip_axis or self.prone
        if self.axis_from is not None:
            if given or lying:
                raise InputError(
                    "give either --axis-from or where the axis lies, not both"
                )
            held: Any = tuple(word.strip() for word in self.probe_axes.split(","))
            return read_axis(self.axis_from, cloud, held=held, depth=self.axis_depth)
        if self.head is not None and self.flip_axis:
            raise InputError("give either --head or --flip-axis, not both")
        if not given:
            head = None if self.head is None else numbers(self.head, 3, "--head")
            return Axis.from_cloud(
                cloud,
                head=head,
                flip=self.flip_axis,
                prone=self.prone,
                support=self.support,
                camera=place,
            )
        if self.axis_origin is None or self.axis_direction is None:
            raise InputError(
                "--axis-origin and --axis-direction go together: give both"
            )
        if self.head is not None:
            raise InputError("--axis-direction points to the head: leave --head out")
        return self._given(cloud, self.axis_origin, self.axis_direction, place)

    def _given(self, cloud: Array, origin: str, direction: str, camera: Any) -> Axis:
        """The frame of an origin and a direction.

        The front is off the support or, without one, towards a known camera.
        """
        import numpy as np

        from ttus_opt.scan.frame import Axis
        from ttus_opt.scan.supporting_plane import find_supporting_plane

        at = np.array(numbers(origin, 3, "--axis-origin"))
        z = np.array(numbers(direction, 3, "--axis-direction"))
        length = float(np.linalg.norm(z))
        if not (np.isfinite(length) and length > 0):
            raise GeometryError(
                f"--axis-direction must not be zero, got {direction}: for instance "
                "0,0,1"
            )
        z *= (-1.0 if self.flip_axis else 1.0) / length
        plane = find_supporting_plane(cloud, camera=camera) if self.support else None
        upward = None if camera is None else np.asarray(camera) - at
        if plane is not None:
            upward = plane.normal
        if upward is None:
            # x: the scan's axis that stands across the body most squarely
            x = np.eye(3)[int(np.argmin(np.abs(z)))]
        else:
            x = (-1.0 if self.prone else 1.0) * np.cross(upward, z)
            x /= max(float(np.linalg.norm(upward)), 1e-9)
        x = x - (x @ z) * z
        size = float(np.linalg.norm(x))
        if size < 0.1:
            raise GeometryError(
                f"--axis-direction {direction} points away from the support or to the "
                "camera: give a direction along the body"
            )
        x /= size
        return Axis(at, np.stack([x, np.cross(z, x), z], axis=1), plane)
