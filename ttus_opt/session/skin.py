"""First step of a session: the patient's surface."""

from __future__ import annotations

from typing import NamedTuple

from ttus_opt.arrays import Array
from ttus_opt.scan.cloud import read_cloud
from ttus_opt.scan.extraction import extract_surface
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.surface import Surface
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
    if scan.file.suffix.lower() == ".nc":
        return Skin(Surface.load(scan.file), None)
    cloud = read_cloud(scan.file, unit=scan.unit)  # type: ignore[arg-type]  # checked there
    axis = Axis.from_cloud(cloud, head=scan.head, prone=scan.prone)
    n_theta, n_z = scan.nodes
    return Skin(extract_surface(cloud, axis=axis, n_theta=n_theta, n_z=n_z), cloud)
