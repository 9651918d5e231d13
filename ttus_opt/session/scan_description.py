"""The part of a session's description about the patient's scan."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ttus_opt.core.arrays import Array
from ttus_opt.probe.held import AXES, USUAL
from ttus_opt.scan.cloud import UNITS
from ttus_opt.session.section import Section

KINDS = ("cloud", "surface", "depth")
OF_CAMERAS = (
    "intrinsics",
    "rays",
    "camera_to_scan",
    "depth_kind",
    "noise",
    "refine",
)
OF_AXIS = ("axis_from", "probe_axes", "axis_depth")


@dataclass(frozen=True)
class Camera:
    """The camera of a depth image.

    Attributes:
        lens: File of its intrinsics, or of its pixels' rays.
        has_rays: Whether ``lens`` holds rays.
        depth_kind: ``z`` or ``range``.
        to_scan: Motion from camera to scan, shape (4, 4).
    """

    lens: Path
    has_rays: bool
    depth_kind: str
    to_scan: Array = field(repr=False)


@dataclass(frozen=True)
class StatedAxis:
    """Source of a stated patient frame.

    Attributes:
        file: A surface (.nc), or poses of a held probe, as in `read_axis`.
        held: The probe's axes into the patient and to the head.
        depth: Depth of the origin below the skin [m]; None for half-way to the bed.
    """

    file: Path
    held: tuple[str, str]
    depth: float | None


@dataclass(frozen=True)
class Scan:
    """Source of the patient's surface.

    Attributes:
        files: A cloud, a surface (.nc), or depth images.
        cameras: One per depth image; none for a cloud or surface.
        noise: Noise model of the cameras; None where unknown.
        refine: Whether the cameras' poses are refined by registration.
        unit: Unit of the coordinates or depths; None for the usual one.
        axis: Source of the patient's frame; None to find it in the scan.
        head: Direction to the head in the scan, shape (3,); None to find it.
        prone: Whether the patient lies on the front.
        nodes: Spokes and slices of the surface.
    """

    files: tuple[Path, ...]
    cameras: tuple[Camera, ...]
    noise: str | None
    refine: bool
    unit: str | None
    axis: StatedAxis | None
    head: tuple[float, ...] | None
    prone: bool
    nodes: tuple[int, ...]


def read_scan(part: Section) -> Scan:
    """The section ``scan`` of a description.

    Raises:
        FileError: Invalid values, or values that exclude each other.
    """
    part.require_known(
        (*KINDS, *OF_CAMERAS, *OF_AXIS, "unit", "head", "prone", "nodes")
    )
    given = [kind for kind in KINDS if kind in part]
    if len(given) != 1:
        raise part.fail(
            "", f"needs one of {', '.join(KINDS)}, got {len(given)} of them"
        )
    files = part.paths(given[0])
    if given[0] != "depth":
        for key in OF_CAMERAS:
            if key in part:
                raise part.fail(key, f"is for depth images, {given[0]} is given")
        if len(files) > 1:
            raise part.fail(given[0], "is one file, got a list")
    return Scan(
        files,
        _cameras(part, len(files)) if given[0] == "depth" else (),
        part.text("noise") if "noise" in part else None,
        part.flag("refine"),
        part.choice("unit", tuple(UNITS)) if "unit" in part else None,
        _axis(part),
        part.numbers("head", 3) if "head" in part else None,
        part.flag("prone"),
        part.whole("nodes", 2, (180, 60)),
    )


def _cameras(part: Section, count: int) -> tuple[Camera, ...]:
    """A camera for every depth image, with one file for all or one each."""
    given = [key for key in ("intrinsics", "rays") if key in part]
    if len(given) > 1:
        raise part.fail("rays", "and intrinsics say the same: give one of both")
    key = given[0] if given else "intrinsics"
    files = part.paths(key)
    motions = part.motions("camera_to_scan")
    if len(files) == 1:
        files *= count
    for name, n in ((key, len(files)), ("camera_to_scan", len(motions))):
        if n != count:
            raise part.fail(name, f"has {n} entries for {count} depth images")
    kind = part.choice("depth_kind", ("z", "range"), "z")
    return tuple(
        Camera(file, key == "rays", kind, motion)
        for file, motion in zip(files, motions, strict=True)
    )


def _axis(part: Section) -> StatedAxis | None:
    """The stated frame; None to find it in the scan."""
    if "axis_from" not in part:
        for key in OF_AXIS[1:]:
            if key in part:
                raise part.fail(key, "is for axis_from, poses of a held probe")
        return None
    for key in ("surface", "head", "prone"):
        if key in part:
            raise part.fail(key, "says where the frame is, and so does axis_from")
    held = part.values.get("probe_axes", list(USUAL))
    # other YAML values may not be hashable
    if not (isinstance(held, list) and len(held) == 2) or not all(
        isinstance(name, str) and name in AXES for name in held
    ):
        raise part.fail(
            "probe_axes",
            f"must be two of {', '.join(AXES)}, into the patient and to the head, got "
            f"{held!r}",
        )
    depth = part.number("axis_depth") if "axis_depth" in part else None
    return StatedAxis(part.path("axis_from"), (held[0], held[1]), depth)
