"""``ttus-opt doctor``: what files hold, as a person would say it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from ttus_opt.cli.console import as_options, tell
from ttus_opt.cli.options import check_outputs
from ttus_opt.core.errors import FileError, InputError, TtusError

if TYPE_CHECKING:
    from ttus_opt.core.arrays import Array
    from ttus_opt.probe.raw_recording import RawRecording


#: Columns of a line
WIDTH = 80


class _Found(NamedTuple):
    """What a file holds.

    Attributes:
        kind: In words.
        lines: For people.
        facts: For machines.
        streams: To be drawn, by name.
    """

    kind: str
    lines: list[str]
    facts: dict[str, Any]
    streams: dict[str, RawRecording]


class _Asked(NamedTuple):
    """How files are read: columns of tables, unit of clouds, the only stream."""

    columns: str
    unit: str | None
    stream: str | None


def doctor(
    files: Annotated[list[Path], typer.Argument()],
    columns: Annotated[str, typer.Option(metavar="NAME=COLUMN,…|FILE")] = "",
    unit: str | None = None,
    stream: str | None = None,
    picture: Path | None = None,
    force: bool = False,
    json: bool = False,
) -> None:
    """Say what files hold: streams, rates, gaps, faults, units, ranges, noise.

    Reads whatever the other commands read: recordings of poses and wrenches, clouds,
    depth images, intrinsics, probe meshes, surfaces and fields. Exit status 0 where
    all can be used, 1 where a recording has faults, 2 where a file cannot be read.

    Args:
        files: The files, or folders of ROS 2.
        columns: Column names of tables, for instance px=tip_x[mm],t=sec+nanosec.
        unit: Unit of clouds, meshes and depth images: m, cm, mm. By default that of
            their kind, or the likely one.
        stream: Say only of this topic, transform, tool or body; of /tf two frames,
            base:tool.
        picture: Draw all recordings over time here.

    Example:
        ttus-opt doctor tracker.csv force.csv scan.ply --picture streams.png
    """
    check_outputs([], list(files), force=force, pictures=[picture])
    asked = _Asked(columns, unit, stream)
    facts, lines, drawn, unreadable, faulty = [], [], {}, False, False
    for file in files:
        try:
            found = _examined(file, asked)
        except TtusError as error:
            unreadable = True
            text = as_options(str(error))
            facts.append({"file": str(file), "error": text})
            lines.append(f"{file}: cannot be used\n    {text}")
            continue
        facts.append({"file": str(file), "kind": found.kind, **found.facts})
        lines.append(f"{file}: {found.kind}")
        lines += [_wrapped(line) for line in found.lines]
        faulty |= any(s["faults"] for s in found.facts.get("streams", []))
        for name, raw in found.streams.items():
            drawn[f"{file.name} {name}".strip()] = raw
    if picture is not None:
        _draw(picture, drawn)
        lines.append(f"picture: {picture}")
    tell({"files": facts}, *lines, json=json)
    if unreadable or faulty:
        raise typer.Exit(2 if unreadable else 1)


def _wrapped(line: str) -> str:
    """A line under its file's, with its continuation further in."""
    import textwrap

    inner = "    " + " " * (len(line) - len(line.lstrip()))
    return textwrap.fill(
        line.strip(),
        WIDTH,
        initial_indent=inner,
        subsequent_indent=f"{inner}  ",
        break_long_words=False,
    )


def _draw(picture: Path, streams: dict[str, RawRecording]) -> None:
    from ttus_opt.report.plots import save_picture
    from ttus_opt.report.plots.streams import stream_picture

    if not streams:
        raise InputError("--picture draws recordings, and none could be read")
    save_picture(stream_picture(streams), picture)


def _examined(file: Path, asked: _Asked) -> _Found:
    """What a file holds, by its suffix; a recording is what is nothing else.

    Raises:
        TtusError: It cannot be read.
    """
    if not file.exists():
        raise FileError(f"{file} not found: check the path")
    suffix = file.suffix.lower()
    for suffixes, examine in EXAMINERS:
        if suffix in suffixes:
            return examine(file, asked)
    return _recording(file, asked)


def _recording(file: Path, asked: _Asked) -> _Found:
    from ttus_opt.sensors.column_map import read_column_map
    from ttus_opt.sensors.diagnosis import diagnosis
    from ttus_opt.sensors.stream_files import format_of, raw_recordings

    kind = format_of(file)
    told = read_column_map(asked.columns) if kind.has_columns else {}
    streams = {raw.name: raw for raw in raw_recordings(file, told, asked.stream)}
    found = [diagnosis(raw) for raw in streams.values()]
    lines = []
    for one in found:
        first, *rest = map(as_options, one.lines())
        lines += [first, *(f"    {line}" for line in rest)]
    facts = {"streams": [one.facts() for one in found]}
    return _Found(kind.title, lines or ["no poses, no wrenches"], facts, streams)


def _bag(file: Path, asked: _Asked) -> _Found:
    """A recording of ROS, and its depth images if it has some."""
    from ttus_opt.sensors.depth_bag import depth_topics
    from ttus_opt.sensors.depth_files import read_depth_frame

    topics = depth_topics(file)
    found = _Found("recording of ROS", [], {}, {})
    if asked.stream in topics:
        topics = [asked.stream]
    else:
        found = _recording(file, asked)
        topics = [] if asked.stream else topics
    lines = found.lines if found.streams or not topics else []
    facts = dict(found.facts)
    for topic in topics:
        depth, frame = read_depth_frame(file, topic=topic)
        words, seen = _depth_facts(depth)
        which = [f"{frame.which}, is read"] if frame else []
        about = [*which, *words, *_camera_lines(file, topic)]
        lines += [f"{topic}: depth images", *(f"    {w}" for w in about)]
        facts |= seen
    return found._replace(lines=lines, facts=facts)


def _camera_lines(file: Path, topic: str | None = None) -> list[str]:
    from ttus_opt.sensors.intrinsics import read_intrinsics

    camera = read_intrinsics(file, topic)
    (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
    lines = [f"camera fx {fx:.2f}, fy {fy:.2f}, cx {cx:.2f}, cy {cy:.2f} pixels"]
    if camera.size is not None:
        (across, down) = camera.size
        angles = (2 * math.atan(n / 2 / f) for n, f in ((across, fx), (down, fy)))
        view = " x ".join(f"{math.degrees(angle):.0f}°" for angle in angles)
        lines[0] += f" for {across} x {down}"
        lines.append(f"a view of {view}")
    bent = ", ".join(f"{k:g}" for k in camera.distortion)
    if not camera.distortion.any():
        bent = "none"
    return [*lines, f"distortion (k1, k2, p1, p2, k3, …): {bent}"]


def _camera(file: Path, asked: _Asked) -> _Found:
    return _Found("camera intrinsics", _camera_lines(file), {}, {})


def _netcdf(file: Path, asked: _Asked) -> _Found:
    """A surface, a field, or a stream."""
    from ttus_opt.core import io

    kind = io.kind_of(file, "surface, field or stream")
    if kind == "surface" or (kind is None and _has_radius(file)):
        from ttus_opt.scan.surface import Surface

        return _Found("surface", [repr(Surface.load(file))], {}, {})
    if kind == "field":
        from ttus_opt.voxmap.field import PotentialField

        return _Found("field", [repr(PotentialField.load(file))], {}, {})
    return _recording(file, asked)


def _has_radius(file: Path) -> bool:
    from ttus_opt.sensors.netcdf_child import read_apart

    try:
        return "radius" in read_apart(file)
    except ValueError:
        return False


def _cloud(file: Path, asked: _Asked) -> _Found:
    import numpy as np

    from ttus_opt.scan.cloud import UNITS, read_cloud

    points, used = None, asked.unit
    guesses: list[Any] = [asked.unit] if asked.unit else ["m", "mm", "cm"]
    for guess in guesses:
        try:
            points, used = read_cloud(file, unit=guess, drop_nan=True), guess
            break
        except InputError:
            if guess == guesses[-1]:
                raise
    assert points is not None
    low, high = points.min(axis=0), points.max(axis=0)
    spans = ", ".join(
        f"{axis} {a:.3f} to {b:.3f}"
        for axis, a, b in zip("xyz", low, high, strict=True)
    )
    lines = [f"{len(points):,} points, {spans} m"]
    if asked.unit is None and used != "m":
        raw = (high - low).max() / UNITS[used or "m"]
        lines.append(
            f"units? it spans {raw:.4g}, so it is likely in {used}: --unit {used}"
        )
    facts = {"points": len(points), "range_m": np.stack([low, high]), "unit": used}
    return _Found("point cloud", lines, facts, {})


def _text_or_cloud(file: Path, asked: _Asked) -> _Found:
    """A table of poses or wrenches, or of points."""
    try:
        return _recording(file, asked)
    except FileError as error:
        try:
            return _cloud(file, asked)
        except TtusError:
            raise error from None


def _depth(file: Path, asked: _Asked) -> _Found:
    from ttus_opt.sensors.depth_files import read_depth

    lines, facts = _depth_facts(read_depth(file, asked.unit))
    return _Found("depth image", lines, facts, {})


def _depth_facts(depth: Array) -> tuple[list[str], dict[str, Any]]:
    """What depths (height, width) [m] say, for people and for machines."""
    import numpy as np

    seen = depth[np.isfinite(depth)]
    low, middle, high = np.quantile(seen, [0.01, 0.5, 0.99])
    share = len(seen) / depth.size
    line = (
        f"{depth.shape[1]} x {depth.shape[0]} pixels, {100 * share:.0f} % with a "
        f"depth, {low:.3f} to {high:.3f} m, {middle:.3f} m in the median"
    )
    facts = {"shape": depth.shape, "seen": share, "median_depth_m": middle}
    return [line], facts


def _array(file: Path, asked: _Asked) -> _Found:
    """Points, or a depth image."""
    from ttus_opt.core import io

    shape = io.read_npy(file).shape
    three = len(shape) == 2 and shape[1] == 3
    return (_cloud if three else _depth)(file, asked)


def _mesh(file: Path, asked: _Asked) -> _Found:
    from ttus_opt.probe.mesh import read_mesh

    unit = asked.unit or "mm"
    mesh = read_mesh(file, unit=unit)
    size = 1e3 * (mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0))
    shape = " x ".join(f"{edge:.0f}" for edge in size)
    lines = [f"{len(mesh.faces):,} faces, {shape} mm read as {unit}"]
    return _Found("probe mesh", lines, {"faces": len(mesh.faces)}, {})


def _ply(file: Path, asked: _Asked) -> _Found:
    """A mesh where it has faces, points otherwise."""
    with file.open("rb") as stream:
        head = stream.read(100_000).split(b"end_header")[0]
    faces = [line.split()[-1] for line in head.splitlines() if b"element face" in line]
    found = _cloud(file, asked)
    if faces and faces[0] not in (b"0",):
        found.lines.append(f"{int(faces[0]):,} faces: a mesh too")
    return found


#: What is examined how, by suffix
EXAMINERS: tuple[tuple[tuple[str, ...], Callable[[Path, _Asked], _Found]], ...] = (
    ((".nc", ".nc4", ".cdf"), _netcdf),
    ((".ply",), _ply),
    ((".pcd", ".xyz", ".pts", ".asc"), _cloud),
    ((".csv", ".txt"), _text_or_cloud),
    ((".png", ".tif", ".tiff"), _depth),
    ((".npy",), _array),
    ((".stl", ".obj"), _mesh),
    ((".json", ".yaml", ".yml", ".xml"), _camera),
    ((".bag",), _bag),
)
