"""First step of a session: the patient's surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.scan.cloud import read_cloud
from ttus_opt.scan.extraction import extract_surface
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.surface import Surface
from ttus_opt.sensors.depth import read_depth_image
from ttus_opt.sensors.depth_noise import noise_model
from ttus_opt.sensors.intrinsics import read_intrinsics
from ttus_opt.session.description import Scan


class Skin(NamedTuple):
    """The patient's skin.

    Attributes:
        surface: r = R(θ, z), with its place in the scan.
        cloud: What it is from, shape (n, 3) [m]; None for a surface that was given.
    """

    surface: Surface
    cloud: Array | None


def find_skin(scan: Scan) -> Skin:
    """The surface of a session's scan.

    Args:
        scan: As described.

    Raises:
        FileError: The file is no cloud or surface.
        InputError: A unit or counts that cannot be used.
        GeometryError: The cloud shows no body.
    """
    if scan.cameras:
        cloud = _depth_cloud(scan)
    elif scan.files[0].suffix.lower() == ".nc":
        return Skin(Surface.load(scan.files[0]), None)
    else:
        cloud = read_cloud(scan.files[0], unit=scan.unit or "m")  # type: ignore[arg-type]  # checked before
    axis = Axis.from_cloud(cloud, head=scan.head, prone=scan.prone)
    n_theta, n_z = scan.nodes
    return Skin(extract_surface(cloud, axis=axis, n_theta=n_theta, n_z=n_z), cloud)


def _depth_cloud(scan: Scan) -> Array:
    """Points of all depth images, frame of the scan, shape (n, 3) [m].

    Raises:
        FileError: An image or intrinsics cannot be read.
        InputError: An image is not of its camera, or shows no surface.
    """
    noise = None if scan.noise is None else noise_model(scan.noise)
    clouds = []
    for file, camera in zip(scan.files, scan.cameras, strict=True):
        image = read_depth_image(
            file,
            read_intrinsics(camera.intrinsics),
            depth_kind=camera.depth_kind,  # type: ignore[arg-type]  # checked before
            unit=scan.unit,
        )
        clouds.append(image.to_cloud(camera.to_scan, noise=noise).points)
    return np.concatenate(clouds)
