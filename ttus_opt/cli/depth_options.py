"""Options about depth images: cameras, their poses and their noise."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ttus_opt.cli.cloud_options import CloudOptions
from ttus_opt.cli.options import numbers
from ttus_opt.core.errors import FileError, InputError, located

if TYPE_CHECKING:
    from ttus_opt.sensors.depth import DepthImage
    from ttus_opt.sensors.stitching import Stitched

#: Suffix of a RealSense's recording
RECORDING = ".bag"

#: Suffixes of files that can only be depth images
IMAGES = (".png", ".tif", ".tiff")

#: Advice of the readers of poses by options that are not here
ABSENT = re.compile(r"; map them by columns.*")


@dataclass(frozen=True)
class DepthOptions:
    """How depth images were taken, as typed.

    Attributes:
        intrinsics: Intrinsics of the depth camera, JSON, YAML or XML as OpenCV, ROS,
            Open3D and RealSense write it; one file for all images, or repeated for
            each. A .bag has its own.
        rays: Instead of --intrinsics: table of the pixels' directions, NPY (h, w, 3) or
            (h, w, 2).
        depth_kind: What a depth measures: z along the optical axis, or range along the
            ray.
        noise: Noise of the camera, from which the contour filter weights the points:
            structured-light, stereo:BASELINE[,DISPARITY_STD] [m, pixel] or
            time-of-flight:STD [m].
        poses: Poses from camera to scan, one line t,px,py,pz,qw,qx,qy,qz per image, or
            a recording of another device with one pose per image.
        pose_quaternion: Order in the columns qw,qx,qy,qz: wxyz as named, or xyzw.
        refine: Refine the poses by GICP (extra sensors: small_gicp).
        pose_std: Accuracy of the measured poses, for --refine.
        stream: Topic of the depth images, if a .bag has several.
        at: Of a .bag, take the image nearest to this time after the first [s]; by
            default the one in the middle.
    """

    intrinsics: list[Path] | None = None
    rays: Path | None = None
    depth_kind: str = "z"
    noise: str | None = None
    poses: Path | None = None
    pose_quaternion: str = "wxyz"
    refine: bool = False
    pose_std: Annotated[str, typer.Option(metavar="METRES,DEGREES")] = "0.005,0.5"
    stream: str | None = None
    at: float | None = None

    def are_given(self, scans: list[Path]) -> bool:
        """Whether the scans are depth images.

        Raises:
            InputError: They are and nothing says where their pixels look, or they are
                not and an option says how they were taken.
        """
        images = [scan for scan in scans if scan.suffix.lower() in IMAGES]
        if self.intrinsics or self.rays or _recordings(scans):
            return True
        if images:
            raise InputError(
                f"{images[0]} is a depth image: give --intrinsics or --rays"
            )
        if self.noise or self.poses or self.refine:
            raise InputError(
                "--noise, --poses and --refine need depth images: give --intrinsics "
                "or --rays with them"
            )
        if self.stream is not None or self.at is not None:
            raise InputError("--stream and --at are for recordings (.bag)")
        return False

    def read(self, cloud: CloudOptions) -> Stitched:
        """The scans in one frame; the first camera's without poses.

        Raises:
            FileError: A file does not hold what it should.
            InputError: Options or files that do not go together.
        """
        import numpy as np

        from ttus_opt.sensors.depth_noise import noise_model
        from ttus_opt.sensors.stitching import (
            PoseUncertainty,
            read_camera_poses,
            stitch,
        )

        scans = cloud.scans
        noise = None if self.noise is None else noise_model(self.noise)
        uncertainty = None
        if self.refine:
            shift, degrees = numbers(self.pose_std, 2, "--pose-std")
            with located("--pose-std"):
                uncertainty = PoseUncertainty(shift, math.radians(degrees))
        if self.poses is not None:
            order: Any = self.pose_quaternion  # checked there
            try:
                poses = read_camera_poses(self.poses, len(scans), order=order)
            except FileError as error:
                raise FileError(ABSENT.sub("", str(error))) from error
        elif len(scans) == 1:
            poses = np.eye(4)[None]
        else:
            raise InputError(
                f"{len(scans)} depth images need the poses of their cameras: give "
                "--poses"
            )
        return stitch(self._images(cloud), poses, noise=noise, refine=uncertainty)

    def _images(self, cloud: CloudOptions) -> list[DepthImage]:
        from ttus_opt.sensors.depth import read_depth_image
        from ttus_opt.sensors.intrinsics import read_intrinsics
        from ttus_opt.sensors.unprojection import read_unprojection

        files = self.intrinsics or []
        if not files and self.rays is None and _recordings(cloud.scans):
            files = cloud.scans  # each has its own
        if bool(files) == (self.rays is not None):
            raise InputError("give either --intrinsics or --rays, not both")
        if len(files) > 1 and len(files) != len(cloud.scans):
            raise InputError(
                f"got {len(files)} --intrinsics for {len(cloud.scans)} images: give "
                "one for all or one for each"
            )
        cameras: list[Any] = [read_intrinsics(file, self.stream) for file in files]
        if self.rays is not None:
            cameras = [read_unprojection(self.rays)]
        if len(cameras) == 1:
            cameras *= len(cloud.scans)
        kind: Any = self.depth_kind  # checked there
        return [
            read_depth_image(
                scan,
                camera,
                depth_kind=kind,
                unit=cloud.unit,
                topic=self.stream,
                at=self.at,
            )
            for scan, camera in zip(cloud.scans, cameras, strict=True)
        ]


def _recordings(scans: list[Path]) -> bool:
    """Whether all scans are recordings, which have their camera's intrinsics."""
    return bool(scans) and all(s.suffix.lower() == RECORDING for s in scans)


def stitched_facts(found: Stitched) -> dict[str, Any]:
    """What was left out and how poses were refined, for machines."""
    return {
        "dropped": [asdict(dropped) for dropped in found.cloud.dropped],
        "refinements": [
            {
                "scan": r.scan + 1,
                "shift_m": r.shift,
                "turn_degrees": math.degrees(r.turn),
                "overlap": r.overlap,
                "residual_before_m": r.residual_before,
                "residual_m": r.residual,
                "condition": r.condition,
            }
            for r in found.refinements
        ],
        "camera_poses": found.poses.tolist(),
        "images": [frame and frame._asdict() for frame in found.frames],
    }


def stitched_lines(found: Stitched) -> list[str]:
    """The same for people."""
    lines = [
        f"scan {k + 1}: {frame}"
        for k, frame in enumerate(found.frames)
        if frame is not None
    ]
    lines += [
        f"scan {k + 1}: left out {d.invalid} pixels without depth, {d.flying} flying, "
        f"{d.grazing} grazing"
        for k, d in enumerate(found.cloud.dropped)
    ]
    return lines + [
        f"scan {r.scan + 1}: camera moved by {1e3 * r.shift:.1f} mm and "
        f"{math.degrees(r.turn):.2f}°, {100 * r.overlap:.0f} % overlap, residual "
        f"{1e3 * r.residual_before:.2f} → {1e3 * r.residual:.2f} mm"
        for r in found.refinements
    ]
