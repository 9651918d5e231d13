"""``ttus-opt record``: poses and forces of an OpenIGTLink server, as they come."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from ttus_opt.cli.console import tell
from ttus_opt.cli.options import check_outputs
from ttus_opt.errors import InputError


def record(
    server: Annotated[str, typer.Argument()],
    poses: Path | None = None,
    wrenches: Path | None = None,
    pose_device: str | None = None,
    sensor: Annotated[str | None, typer.Option("--wrench-device")] = None,
    seconds: float | None = None,
    json: bool = False,
) -> None:
    """Record a tracker's poses and a force sensor's readings over OpenIGTLink.

    The files are written at the end, also after Ctrl-C.

    Args:
        server: HOST or HOST:PORT of the server.
        poses: Write TRANSFORM messages here (CSV).
        wrenches: Write SENSOR messages here (CSV).
        pose_device: Device of the poses, if several send poses.
        sensor: Device of the forces, where several send some.
        seconds: Duration from the first message [s]. By default until Ctrl-C.

    Example:
        ttus-opt record localhost:18944 --poses tracker.csv --seconds 60
    """
    import numpy as np

    from ttus_opt.sensors import open_igt_link as igt

    if poses is None and wrenches is None:
        raise InputError("no output file: give --poses or --wrenches")
    check_outputs([poses, wrenches], [], force=False)
    host, _, port = server.partition(":")
    if port and not port.isdigit():
        raise InputError(f"SERVER must be HOST or HOST:PORT, got {server!r}")
    shown = _counter()
    received = igt.record(host, int(port or igt.PORT), seconds=seconds, progress=shown)
    facts: dict[str, object] = {"messages": received.count}
    lines, failed = [], []
    # what came cannot be had again: one file is written whatever the other lacks
    for key, count, file, find in (
        ("poses", "pose_frames", poses, lambda: received.trajectory(pose_device)),
        ("wrenches", "wrench_frames", wrenches, lambda: received.wrenches(sensor)),
    ):
        if file is None:
            continue
        try:
            stream = find()
        except InputError as error:
            failed.append(str(error))
            continue
        stream.save(file)
        frames = len(stream.time)
        facts |= {key: str(file), count: frames}
        lines.append(f"{file}: {frames} frames, {np.ptp(stream.time):.1f} s")
    if failed:
        raise InputError("; ".join([*failed, *(f"written {line}" for line in lines)]))
    tell(facts, *lines, json=json)


def _counter() -> Callable[[int], None] | None:
    """A counter of messages on a terminal's stderr; None elsewhere."""
    import sys

    if not sys.stderr.isatty():
        return None
    from tqdm import tqdm

    bar = tqdm(file=sys.stderr, unit=" messages", leave=False)

    def show(count: int) -> None:
        bar.update(count - bar.n)

    return show
