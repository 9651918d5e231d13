"""``ttus-opt doctor``: what files hold, as a person would say it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ttus_opt.cli.console import Stages, as_options, tell
from ttus_opt.cli.examination import Asked, examined
from ttus_opt.cli.options import numbers
from ttus_opt.core.errors import InputError, TtusError

if TYPE_CHECKING:
    from ttus_opt.probe.raw_recording import RawRecording


#: Columns of a line
WIDTH = 80


def doctor(
    files: Annotated[list[Path], typer.Argument()],
    columns: Annotated[str, typer.Option(metavar="NAME=COLUMN,…|FILE")] = "",
    unit: str | None = None,
    stream: str | None = None,
    box: Annotated[
        str | None, typer.Option(metavar="xmin,xmax,ymin,ymax,zmin,zmax")
    ] = None,
    picture: Path | None = None,
) -> None:
    """Say what files hold: streams, rates, gaps, faults, units, ranges, noise.

    Reads whatever the other commands read: recordings of poses and wrenches, clouds,
    depth images, intrinsics, probe meshes, surfaces, fields, paths of weights,
    messages, rigid motions, pairs of poses, photos and sessions. Exit status 0 where
    all can be used, 1 where a recording has faults, 2 where a file cannot be read.

    Args:
        files: The files, folders of ROS 2, or of sessions.
        columns: Column names of tables, for instance px=tip_x[mm],t=sec+nanosec.
        unit: Unit of clouds, meshes and depth images: m, cm, mm. By default that of
            their kind, or the likely one.
        box: Of clouds, only the points inside this box [m].
        stream: Say only of this topic, transform, tool or body; of /tf two frames,
            base:tool.
        picture: Draw all recordings over time here.

    Example:
        ttus-opt doctor tracker.csv force.csv scan.ply --picture streams.png
    """
    limits = None if box is None else numbers(box, 6, "--box")
    asked = Asked(columns, unit, stream, limits)
    facts, lines, drawn, unreadable, faulty = [], [], {}, False, False
    with Stages(len(files)) as begin:
        for file in files:
            begin(file.name)
            try:
                found = examined(file, asked)
            except TtusError as error:
                unreadable = True
                text = as_options(str(error))
                facts.append({"file": str(file), "error": text})
                lines += [f"{file}: cannot be used", _wrapped(text)]
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
    tell({"files": facts}, *lines)
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
