"""First step of a session: the patient's surface."""

from __future__ import annotations

from typing import NamedTuple

from ttus_opt.core.arrays import Array
from ttus_opt.scan.cloud import read_cloud
from ttus_opt.scan.extraction import extract_surface
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.surface import Surface
from ttus_opt.sensors.depth import read_depth_image
from ttus_opt.sensors.depth_noise import noise_model
from ttus_opt.sensors.intrinsics import read_intrinsics
from ttus_opt.sensors.probe_axis import read_axis
from ttus_opt.sensors.stitching import PoseUncertainty, Stitched, stitch
from ttus_opt.sensors.unprojection import read_unprojection
from ttus_opt.session.scan_description import Scan


class Skin(NamedTuple):
    """The patient's skin.

    Attributes:
        surface: r = R(θ, z), with its axis in the scan.
        cloud: Its points, shape (n, 3) [m]; None for a given surface.
    """

    surface: Surface
    cloud: Array | None


def find_skin(scan: Scan) -> Skin:
    """The surface of a session's scan.

    Raises:
        FileError: A file is not a cloud, a surface, a depth image or intrinsics.
        InputError: An invalid unit or count, an image that is not of its camera, or a
            refused refinement.
        GeometryError: The cloud shows no body, or none below the held probe.
    """
    std, camera = None, None
    if scan.cameras:
        stitched = _stitched(scan)
        camera = stitched.seen_from
        seen = stitched.cloud.of_patient(scan.files[0].name)
        cloud, std = seen.points, seen.std
    elif scan.files[0].suffix.lower() == ".nc":
        return Skin(Surface.load(scan.files[0]), None)
    else:
        cloud = read_cloud(scan.files[0], unit=scan.unit or "m")  # type: ignore[arg-type]  # checked before
    axis = _frame(scan, cloud, camera)
    n_theta, n_z = scan.nodes
    surface = extract_surface(cloud, axis=axis, n_theta=n_theta, n_z=n_z, point_std=std)
    return Skin(surface, cloud)


def _frame(scan: Scan, cloud: Array, camera: Array | None) -> Axis:
    """The patient's frame, as stated or found in the scan."""
    stated = scan.axis
    if stated is None:
        return Axis.from_cloud(cloud, head=scan.head, prone=scan.prone, camera=camera)
    return read_axis(stated.file, cloud, held=stated.held, depth=stated.depth)


def _stitched(scan: Scan) -> Stitched:
    """All depth images in the frame of the scan."""
    images = [
        read_depth_image(
            file,
            (read_unprojection if camera.has_rays else read_intrinsics)(camera.lens),
            depth_kind=camera.depth_kind,  # type: ignore[arg-type]  # checked before
            unit=scan.unit,
        )
        for file, camera in zip(scan.files, scan.cameras, strict=True)
    ]
    return stitch(
        images,
        [camera.to_scan for camera in scan.cameras],
        noise=None if scan.noise is None else noise_model(scan.noise),
        refine=PoseUncertainty() if scan.refine else None,
    )
