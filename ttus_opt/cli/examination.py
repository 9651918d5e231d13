"""What a file of any kind holds, in words and figures."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ttus_opt.cli.console import as_options
from ttus_opt.core.errors import FileError, InputError, TtusError, counted

if TYPE_CHECKING:
    from ttus_opt.core.arrays import Array
    from ttus_opt.probe.raw_recording import RawRecording


class Found(NamedTuple):
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


class Asked(NamedTuple):
    """How files are read: columns, unit, the only stream, box of clouds."""

    columns: str
    unit: str | None
    stream: str | None
    box: tuple[float, ...] | None = None


#: Examines a file of one kind
Way = Callable[[Path, Asked], Found]


def examined(file: Path, asked: Asked) -> Found:
    """What a file holds, by its suffix; a recording is what is nothing else.

    Raises:
        TtusError: It cannot be read.
    """
    if not file.exists():
        raise FileError(f"{file} not found: check the path")
    from ttus_opt.session.description import NAMES

    if file.name in NAMES or any((file / name).exists() for name in NAMES):
        return _session(file)
    suffix = file.suffix.lower()
    ways = next((w for s, w in EXAMINERS if suffix in s), (_recording,))
    if _motion in ways and _bare(file):
        ways = (_motion,) if suffix in TEXT else ways[1:]
    try:
        return ways[0](file, asked)
    except FileError:
        for other in ways[1:]:
            with contextlib.suppress(TtusError):
                return other(file, asked)
        raise


def _recording(file: Path, asked: Asked) -> Found:
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
    return Found(kind.title, lines or ["no poses, no wrenches"], facts, streams)


def _bag(file: Path, asked: Asked) -> Found:
    """A recording of ROS, and its depth images if it has some."""
    from ttus_opt.sensors.depth_bag import depth_topics
    from ttus_opt.sensors.depth_files import read_depth

    topics = depth_topics(file)
    found = Found("recording of ROS", [], {}, {})
    if asked.stream in topics:
        topics = [asked.stream]
    else:
        found = _recording(file, asked)
        topics = [] if asked.stream else topics
    lines = found.lines if found.streams or not topics else []
    facts = dict(found.facts)
    for topic in topics:
        depth, frame = read_depth(file, topic=topic)
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


def _bare(file: Path) -> bool:
    """Whether a file holds a list, or no more rows of numbers than a motion has."""
    from ttus_opt.core import io

    with io.existing_file(file, "file").open("rb") as stream:
        rows = stream.read(2000).strip().splitlines()
    pattern = rb"\[" if len(rows) > 4 else rb"[-+.\d\[]"
    return bool(rows and re.match(pattern, rows[0]))


def _intrinsics(file: Path, asked: Asked) -> Found:
    return Found("camera intrinsics", _camera_lines(file), {}, {})


def _motion(file: Path, asked: Asked) -> Found:
    from scipy.spatial.transform import Rotation

    from ttus_opt.probe.rigid_motion import read_rigid_motion

    motion = read_rigid_motion(file)
    turn = math.degrees(Rotation.from_matrix(motion[:3, :3]).magnitude())
    place = ", ".join(f"{x:.4f}" for x in motion[:3, 3])
    line = f"to ({place}) m, turned by {turn:.1f}°"
    return Found("rigid motion", [line], {"motion": motion}, {})


def _pairs(file: Path, asked: Asked) -> Found:
    from ttus_opt.sensors.hand_eye import read_pose_pairs

    count = len(read_pose_pairs(file)[0])
    lines = [f"{counted(count, 'pair')}, for ttus-opt register hand-eye"]
    return Found("pairs of poses", lines, {"pairs": count}, {})


def _session(file: Path) -> Found:
    from ttus_opt.session.description import read_description

    told = read_description(file)
    images = counted(len(told.scan.files), "depth image")
    scan = images if told.scan.cameras else "one file"
    lines = [
        f"scan: {scan}; probe: {Path(told.probe).name}",
        "recordings: " + ", ".join(part.name for part in told.recordings),
        "its description is sound; doctor its files, or run ttus-opt session",
    ]
    return Found(f"session: {told.title}", lines, {"title": told.title}, {})


def _message(file: Path, asked: Asked) -> Found:
    from ttus_opt.message.envelope import read_message

    content, kind = read_message(file)
    lines = [f"{len(content):,} bytes, sound: see ttus-opt decode"]
    return Found(f"message: {kind}", lines, {"bytes": len(content)}, {})


def _netcdf(file: Path, asked: Asked) -> Found:
    """A surface, a field, or a stream."""
    from ttus_opt.core import io

    what = "surface, field or stream"
    kind = io.kind_of(file, what)
    if kind is None and "radius" in io.content_of(file, what)[0].variables:
        kind = "surface"
    if kind == "surface":
        from ttus_opt.scan.surface import Surface

        return Found("surface", [repr(Surface.load(file))], {}, {})
    if kind == "field":
        from ttus_opt.voxmap.field import PotentialField

        return Found("field", [repr(PotentialField.load(file))], {}, {})
    if kind == "solution path":
        from ttus_opt.fitting.path.path_dataset import read_solution_path

        path = read_solution_path(file)
        done, points = path.attrs["points_done"], path.attrs["points"]
        line = f"{path.attrs['formulation']}, {done} of {points} points computed"
        return Found("path of weights", [line], {"points": int(points)}, {})
    return _recording(file, asked)


def _cloud(file: Path, asked: Asked) -> Found:
    import numpy as np

    from ttus_opt.scan.cloud import UNITS, extent_words, read_cloud

    guesses: list[Any] = [asked.unit] if asked.unit else ["m", "mm", "cm"]
    failed: list[InputError] = []
    for used in guesses:
        try:
            points = read_cloud(file, unit=used, drop_nan=True, box=asked.box)
            break
        except InputError as error:
            failed.append(error)
    else:
        raise failed[0]
    low, high = points.min(axis=0), points.max(axis=0)
    lines = [f"{len(points):,} points, {extent_words(points)} m"]
    if asked.unit is None and used != "m":
        raw = (high - low).max() / UNITS[used]
        lines.append(
            f"units? it spans {raw:.4g}, so it is likely in {used}: --unit {used}"
        )
    facts = {"points": len(points), "range_m": np.stack([low, high]), "unit": used}
    return Found("point cloud", lines, facts, {})


def _depth(file: Path, asked: Asked) -> Found:
    from ttus_opt.sensors.depth_files import PictureError, read_depth

    try:
        lines, facts = _depth_facts(read_depth(file, asked.unit)[0])
    except PictureError:
        if file.suffix.lower() == ".npy":
            raise
        return _photo(file, asked)
    return Found("depth image", lines, facts, {})


def _photo(file: Path, asked: Asked) -> Found:
    from ttus_opt.sensors.marker_pose import read_image

    height, width = read_image(file).shape
    line = f"{width} x {height} pixels, no depths; its markers: ttus-opt register"
    return Found("photo", [line], {"shape": (height, width)}, {})


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


def _array(file: Path, asked: Asked) -> Found:
    """Points, or a depth image."""
    from ttus_opt.core import io

    shape = io.read_npy(file).shape
    if shape == (4, 4):
        return _motion(file, asked)
    if len(shape) == 4:
        return _pairs(file, asked)
    three = len(shape) == 2 and shape[1] == 3
    return (_cloud if three else _depth)(file, asked)


def _mesh(file: Path, asked: Asked) -> Found:
    from ttus_opt.probe.mesh import read_mesh

    unit = asked.unit or "mm"
    mesh = read_mesh(file, unit=unit)
    size = 1e3 * (mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0))
    shape = " x ".join(f"{edge:.0f}" for edge in size)
    lines = [f"{len(mesh.faces):,} faces, {shape} mm read as {unit}"]
    return Found("probe mesh", lines, {"faces": len(mesh.faces)}, {})


def _ply(file: Path, asked: Asked) -> Found:
    """A mesh where it has faces, points otherwise."""
    with file.open("rb") as stream:
        head = stream.read(100_000).split(b"end_header")[0]
    faces = [line.split()[-1] for line in head.splitlines() if b"element face" in line]
    found = _cloud(file, asked)
    if faces and faces[0] not in (b"0",):
        found.lines.append(f"{int(faces[0]):,} faces: a mesh too")
    return found


#: Tables, which hold a motion where they hold no more than its numbers
TEXT = (".csv", ".txt")

#: What is examined how, by suffix: the first way that can read it, whose error it is
#: where none can; a file of few numbers alone holds neither table nor intrinsics
EXAMINERS: tuple[tuple[tuple[str, ...], tuple[Way, ...]], ...] = (
    ((".nc", ".nc4", ".cdf"), (_netcdf,)),
    ((".ply",), (_ply,)),
    ((".pcd", ".xyz", ".pts", ".asc"), (_cloud,)),
    (TEXT, (_recording, _motion, _cloud)),
    ((".png", ".tif", ".tiff"), (_depth,)),
    ((".npy",), (_array,)),
    ((".stl", ".obj"), (_mesh,)),
    ((".json", ".yaml", ".yml", ".xml"), (_intrinsics, _motion, _pairs)),
    ((".jpg", ".jpeg", ".bmp"), (_photo,)),
    ((".msg",), (_message,)),
    ((".bag",), (_bag,)),
)
