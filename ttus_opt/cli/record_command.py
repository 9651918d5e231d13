"""``ttus-opt record``: poses and forces of an OpenIGTLink server, as they come."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ttus_opt.cli.console import as_options, bars_shown, tell
from ttus_opt.core.errors import FileError, InputError, TtusWarning, warn

if TYPE_CHECKING:
    from ttus_opt.sensors.open_igt_link import Received


def record(
    server: Annotated[str, typer.Argument()],
    poses: Path | None = None,
    wrenches: Path | None = None,
    pose_device: str | None = None,
    sensor: Annotated[str | None, typer.Option("--wrench-device")] = None,
    seconds: float | None = None,
) -> None:
    """Record a tracker's poses and a force sensor's readings over OpenIGTLink.

    Every 5 s, less often in recordings of hours, the files are written anew, and at
    the end, also after Ctrl-C. Damaged messages and poses that are none are dropped
    and counted.

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
    from ttus_opt.sensors import open_igt_link as igt

    if poses is None and wrenches is None:
        raise InputError("no output file: give --poses or --wrenches")
    host, _, port = server.partition(":")
    if port and not port.isdigit():
        raise InputError(f"SERVER must be HOST or HOST:PORT, got {server!r}")
    files = _Files(poses, pose_device, wrenches, sensor)
    received = igt.record(
        host,
        int(port or igt.PORT),
        seconds=seconds,
        progress=_counter(),
        keep=files.keep,
    )
    facts, lines, missing = files.write(received)
    if missing:
        raise InputError("; ".join([*missing, *(f"written {line}" for line in lines)]))
    tell(facts, *lines)


@dataclass(frozen=True)
class _Files:
    """What is written, and from which device."""

    poses: Path | None
    pose_device: str | None
    wrenches: Path | None
    sensor: str | None

    def write(self, got: Received) -> tuple[dict[str, object], list[str], list[str]]:
        """Write what came; facts, lines, and why a stream is missing."""
        facts: dict[str, object] = {"messages": got.count}
        facts |= {"dropped": dict(got.dropped), "ended": got.ended or None}
        lines, missing = [], []
        # what came cannot be had again: one file is written whatever the other lacks
        poses = self.poses, self.pose_device, "--pose-device"
        wrenches = self.wrenches, self.sensor, "--wrench-device"
        for key, count, (file, device, option), find, sent, unit in (
            ("poses", "pose_frames", poses, got.trajectory, got.poses, "mm"),
            (
                "wrenches",
                "wrench_frames",
                wrenches,
                got.wrenches,
                got.readings,
                "N, N m",
            ),
        ):
            if file is None:
                continue
            try:
                stream = find(device)
            except InputError as error:
                missing.append(as_options(str(error), device=option))
                continue
            stream.save(file)
            frames, seconds = len(stream.time), float(stream.time[-1] - stream.time[0])
            facts |= {key: str(file), count: frames}
            name = device or next(iter(sent))
            rate = f"{(frames - 1) / seconds:.4g} Hz, " if seconds else ""
            line = f"{file}: {frames} frames of {name}, {seconds:.1f} s, {rate}"
            lines.append(f"{line}sent in {unit}")
        return facts, lines, missing

    def keep(self, received: Received) -> None:
        """Write what came so far; only the end of a recording tells what is wrong."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", TtusWarning)
                self.write(received)
        except FileError as error:
            warn(str(error))


def _counter() -> Callable[[int], None] | None:
    """A counter of messages on a terminal's stderr; None elsewhere."""
    import sys

    if not sys.stderr.isatty():
        return None
    from tqdm import tqdm

    bar = tqdm(file=sys.stderr, unit=" messages", leave=False, disable=not bars_shown())

    def show(count: int) -> None:
        bar.update(count - bar.n)

    return show
