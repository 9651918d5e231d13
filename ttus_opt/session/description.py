"""The description of a recording folder, its ``session.yaml``, read and checked.

File names are relative to the description's folder. Frames: *tracker*, of the tracker's
poses; *scan*, of the cloud or the depth cameras' poses; *patient*, of the surface,
which the session finds.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.core.io import shortened
from ttus_opt.fitting.weights.weight_choice import word_for
from ttus_opt.probe.pose import from_quaternions
from ttus_opt.sensors.clock import LARGEST_OFFSET
from ttus_opt.sensors.column_map import column_map, read_column_map
from ttus_opt.sensors.force_sensor import ForceSensor
from ttus_opt.sensors.mapping_file import read_mapping
from ttus_opt.session.scan_description import Scan, read_scan
from ttus_opt.session.section import Section

#: File names of a description, in order of preference
NAMES = ("session.yaml", "session.yml", "session.json")

PARTS = (
    "title",
    "probe",
    "probe_unit",
    "scan",
    "tracker",
    "force",
    "clock",
    "free",
    "recordings",
    "fit",
)
FRAMES = ("tracker", "scan", "patient")
CLOCKS = ("gravity", "contact", "offset")


@dataclass(frozen=True)
class Stream:
    """A file of poses or wrenches.

    Attributes:
        file: Any file that `ttus_opt.sensors.stream_files` reads.
        name: Name of a transform or topic in it; None for the only one.
        columns: The file's names, by the package's.
    """

    file: Path
    name: str | None
    columns: Mapping[str, str]


@dataclass(frozen=True)
class Tracker:
    """Poses of a target on the probe.

    Attributes:
        stream: The poses: target to ``frame``.
        frame: One of `FRAMES`.
        to_scan: Motion from tracker to scan, shape (4, 4); None where `tags` give it or
            it is not needed.
        tags: Pairs of poses: tag in the scan, target in the tracker.
        probe_to_target: Motion, shape (4, 4).
    """

    stream: Stream
    frame: str
    to_scan: Array | None = field(repr=False)
    tags: Path | None
    probe_to_target: Array = field(repr=False)


@dataclass(frozen=True)
class Force:
    """Readings of a force sensor.

    Attributes:
        stream: Raw readings, sensor axes, or contact wrenches where ``sensor`` is None.
        sensor: How it is mounted.
        down: Direction of gravity, shape (3,).
        down_frame: One of `FRAMES`.
        frame: Axes of contact wrenches: one of `FRAMES`, or ``probe``.
    """

    stream: Stream
    sensor: ForceSensor | None
    down: tuple[float, ...] | None
    down_frame: str
    frame: str


@dataclass(frozen=True)
class Clock:
    """How the two clocks are synchronised.

    Attributes:
        by: One of `CLOCKS`.
        offset: Added to the times of forces, where it is known [s].
        largest_offset: Half the search range of the offset [s].
        together: Whether both recordings began at about the same time.
        largest_gap: Longest gap that is interpolated over [s].
    """

    by: str
    offset: float
    largest_offset: float
    together: bool
    largest_gap: float


@dataclass(frozen=True)
class Part:
    """A stretch of the tracker's recording.

    Attributes:
        name: Name of its file.
        start: Seconds after the tracker's first pose [s].
        end: Seconds after the tracker's first pose [s].
        fitted: Whether the field is fitted to it; otherwise it is tested on it.
    """

    name: str
    start: float
    end: float
    fitted: bool = True


@dataclass(frozen=True)
class FitPlan:
    """How the field is fitted.

    Attributes:
        formulation: Name, or the path of a file beside the description; None for
            the default model.
        shape: Voxels in r, θ and z.
        r_inner: Radius of the innermost layer [m].
        solver: Name, or auto.
        options: Options of the formulation.
        weights: auto or own, see `ttus_opt.fit`.
    """

    formulation: str | None
    shape: tuple[int, ...]
    r_inner: float
    solver: str
    options: Mapping[str, float]
    weights: str


@dataclass(frozen=True)
class Description:
    """A session.

    Attributes:
        file: The description.
        title: Title of the report.
        probe: A primitive, or the path of a mesh.
        probe_unit: Unit of a mesh.
        scan: Source of the patient's surface.
        tracker: Poses.
        force: Wrenches.
        clock: How both are synchronised.
        free: The stretch in free air; None where readings are compensated.
        recordings: Stretches to fit to and to test on.
        fit: How the field is fitted.
    """

    file: Path
    title: str
    probe: str
    probe_unit: str
    scan: Scan
    tracker: Tracker
    force: Force
    clock: Clock
    free: Part | None
    recordings: tuple[Part, ...]
    fit: FitPlan

    @property
    def fitted(self) -> list[str]:
        """Names of the stretches that the field is fitted to."""
        return [part.name for part in self.recordings if part.fitted]


def read_description(
    path: str | os.PathLike[str], *, trust: bool = False
) -> Description:
    """Read and check a description; no recording is opened yet.

    Args:
        path: The folder, or the YAML or JSON file.
        trust: Whether it may name files of Python code, which are then executed.

    Raises:
        FileError: No description, an unknown key, a missing file, or an invalid value;
            the message names file and key.
    """
    file = _found(Path(path))
    whole = Section(file, "", read_mapping(file, "session"))
    whole.require_known(PARTS)
    free = None
    if "free" in whole:
        free = _part(whole.section("free"), "free", ("from", "to"))
    tracker, force = _tracker(whole.section("tracker")), _force(whole.section("force"))
    if (force.sensor is None) != (free is None):
        raise whole.fail(
            "free" if free is None else "force.sensor",
            "is missing: raw readings need both the stretch in free air (free) and how "
            "the sensor is mounted (force.sensor); contact wrenches neither",
        )
    probe = whole.text("probe")
    return Description(
        file,
        whole.text("title", file.parent.resolve().name or "Session"),
        probe if ":" in probe else str(whole.path("probe")),
        whole.text("probe_unit", "mm"),
        read_scan(whole.section("scan")),
        tracker,
        force,
        _clock(whole.section("clock"), free is not None),
        free,
        _recordings(whole.section("recordings")),
        _fit(whole.section("fit"), trust),
    )


def _found(path: Path) -> Path:
    """The description's file; `FileError` where there is none."""
    if not path.exists():
        raise FileError(f"session not found: {path}: check the path")
    if not path.is_dir():
        return path
    for name in NAMES:
        if (path / name).is_file():
            return path / name
    raise FileError(
        f"{path} has no {NAMES[0]} that describes it: write one after that in "
        "recording/ of ttus-opt example"
    )


def _stream(part: Section) -> Stream:
    given = part.values.get("columns")
    try:
        if given is None:
            columns = {}
        elif isinstance(given, Mapping):
            columns = column_map(given)
        else:
            text = part.text("columns")
            beside = part.file.parent / text
            columns = read_column_map(beside if beside.is_file() else text)
    except InputError as error:
        raise part.fail("columns", f"cannot be used: {error}") from error
    name = part.text("name") if "name" in part else None
    return Stream(part.path("file"), name, columns)


def _tracker(part: Section) -> Tracker:
    part.require_known(
        ("file", "name", "columns", "frame", "to_scan", "tags", "probe_to_target")
    )
    frame = part.choice("frame", FRAMES, "tracker")
    given = [key for key in ("to_scan", "tags") if key in part]
    if frame == "tracker" and len(given) != 1:
        raise part.fail(
            "to_scan",
            "or tags must be given, one of both: the motion from tracker to scan, or "
            "pairs of poses that it is found from",
        )
    if frame != "tracker" and given:
        raise part.fail(given[0], f"is for frame tracker, poses are in the {frame}'s")
    target = part.motion("probe_to_target") if "probe_to_target" in part else np.eye(4)
    return Tracker(
        _stream(part),
        frame,
        part.motion("to_scan") if "to_scan" in part else None,
        part.path("tags") if "tags" in part else None,
        target,
    )


def _force(part: Section) -> Force:
    part.require_known(
        ("file", "name", "columns", "sensor", "down", "down_frame", "frame")
    )
    stream = _stream(part)
    if "sensor" not in part:
        axes = part.choice("frame", (*FRAMES, "probe"))
        return Force(stream, None, None, "scan", axes)
    mounted = part.section("sensor")
    mounted.require_known(("axes", "point", "sign"))
    if "frame" in part:
        raise part.fail("frame", "is for contact wrenches; sensor.axes says it of raw")
    try:
        quaternion = np.array([mounted.numbers("axes", 4)])
        sensor = ForceSensor(
            from_quaternions(quaternion, "xyzw")[0],
            np.array(mounted.numbers("point", 3)),
            mounted.text("sign"),  # type: ignore[arg-type]  # checked there
        )
    except InputError as error:
        raise part.fail("sensor", f"cannot be used: {error}") from error
    down_frame = part.choice("down_frame", FRAMES, "scan")
    return Force(stream, sensor, part.numbers("down", 3), down_frame, "")


def _clock(part: Section, raw: bool) -> Clock:
    part.require_known(("by", "offset", "largest_offset", "together", "largest_gap"))
    usual = "offset" if "offset" in part else "gravity" if raw else "contact"
    by = part.choice("by", CLOCKS, usual)
    if (by == "offset") != ("offset" in part):
        raise part.fail("offset", "and by: offset go together: give both or none")
    if by != "offset" and (by == "gravity") != raw:
        raise part.fail(
            "by",
            f"is {by}: gravity tells the offset of raw readings in free air, contact "
            "that of contact wrenches",
        )
    return Clock(
        by,
        part.number("offset", 0.0),
        part.number("largest_offset", LARGEST_OFFSET),
        part.flag("together"),
        part.number("largest_gap", 0.1),
    )


def _part(part: Section, name: str, known: tuple[str, ...]) -> Part:
    part.require_known(known)
    start, end = part.number("from"), part.number("to")
    if not 0.0 <= start < end:
        raise part.fail(
            "to",
            f"must be after from, both seconds after the tracker's first pose, "
            f"got {start:g} to {end:g}",
        )
    fitted = "use" in known and part.choice("use", ("fit", "test")) == "fit"
    return Part(name, start, end, fitted)


def _recordings(part: Section) -> tuple[Part, ...]:
    parts = []
    for name in part.values:
        if not re.fullmatch(r"[A-Za-z0-9][\w.-]{0,60}", name):
            raise part.fail(
                name, "must be a name of letters, digits, _, . and -: it names a file"
            )
        parts.append(_part(part.section(name), name, ("from", "to", "use")))
    for use, fitted in (("fit", True), ("test", False)):
        if not any(each.fitted == fitted for each in parts):
            raise part.fail("", f"has no stretch with use: {use}, one is needed")
    return tuple(parts)


def _fit(part: Section, trust: bool) -> FitPlan:
    part.require_known(
        ("formulation", "shape", "r_inner", "solver", "options", "weights")
    )
    formulation = part.text("formulation") if "formulation" in part else None
    solver = part.text("solver", "auto")
    for key, name in (("formulation", formulation), ("solver", solver)):
        if name and Path(name).suffix == ".py" and not trust:
            raise part.fail(
                key,
                f"names the code {shortened(name)}, which would be executed: read it, "
                "then pass --trust",
            )
    if formulation and (part.file.parent / formulation).is_file():
        formulation = str(part.file.parent / formulation)
    section = part.section("options")
    options = {name: section.number(name) for name in section.values}
    word = part.text("weights") if "weights" in part else None
    try:
        weights = word_for(word, formulation, options)
    except InputError as error:
        key = "formulation" if word is None else "weights"
        raise part.fail(key, f"cannot be used: {error}") from error
    return FitPlan(
        formulation,
        part.whole("shape", 3, (48, 120, 60)),
        part.number("r_inner", 0.03),
        solver,
        options,
        weights,
    )
