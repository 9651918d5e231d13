"""PLUS sequence files (``.mha``): transforms, status and times of every frame.

The text before the pixels has, for frame 12, lines such as

    Seq_Frame0012_ProbeToTrackerTransform = 1 0 0 15.2 0 1 0 …
    Seq_Frame0012_ProbeToTrackerTransformStatus = OK
    Seq_Frame0012_Timestamp = 213.4

with matrices row by row and translations in mm. Pixels are not read.
"""

from __future__ import annotations

import os
import re

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.probe.trajectory import Trajectory

#: Most text before the pixels [byte]
LONGEST_TEXT = 200_000_000

LINE = re.compile(r"Seq_Frame(\d+)_(\w+?) *= *(.*)")

#: Unit of translations in PLUS [m]
MILLIMETRE = 1e-3


def read_plus_sequence(
    path: str | os.PathLike[str], transform: str | None = None
) -> Trajectory:
    """Poses of a PLUS sequence file.

    Args:
        path: The file.
        transform: Such as ``ProbeToTracker``; may be left out where there is only one.

    Returns:
        Frames whose status is OK; a new segment begins after each gap.

    Raises:
        FileError: Missing, damaged, not a PLUS sequence, no such transform, or several
            to choose from.
    """
    file = io.existing_file(path, "PLUS sequence")
    frames = _frames(file)
    known = sorted(
        {
            name.removesuffix("Transform")
            for frame in frames.values()
            for name in frame
            if name.endswith("Transform")
        }
    )
    if not known:
        raise FileError(f"{file} has no transforms: not a PLUS sequence with tracking")
    if transform is None and len(known) > 1:
        raise FileError(
            f"{file} has several transforms: name one of {', '.join(known)}"
        )
    wanted = (known[0] if transform is None else transform).removesuffix("Transform")
    if wanted not in known:
        raise FileError(f"{file} has no transform {wanted}: one of {', '.join(known)}")
    try:
        return _poses(frames, f"{wanted}Transform")
    except (InputError, ValueError) as error:
        raise FileError(f"{file}, {wanted}: {error}") from error


def _frames(file: os.PathLike[str]) -> dict[int, dict[str, str]]:
    """Fields of every frame, by its number.

    Raises:
        FileError: Not a MetaImage file.
    """
    frames: dict[int, dict[str, str]] = {}
    read = 0
    with open(file, "rb") as stream:
        for line in iter(lambda: stream.readline(1_000_000), b""):
            read += len(line)
            text = line.decode("latin-1").strip()
            if read == len(line) and "=" not in text:
                raise FileError(f"{file} is not a MetaImage file: expected a .mha")
            if text.startswith("ElementDataFile") or read > LONGEST_TEXT:
                break
            found = LINE.fullmatch(text)
            if found and len(found[1]) < 10:
                frames.setdefault(int(found[1]), {})[found[2]] = found[3]
    return frames


def _poses(frames: dict[int, dict[str, str]], name: str) -> Trajectory:
    """Poses of the frames with a valid transform.

    Raises:
        InputError: No frame is valid, or a transform is not rigid.
        ValueError: Text where numbers are expected.
    """
    time, matrices, segment, part = [], [], [], 0
    for number in sorted(frames):
        frame = frames[number]
        if name not in frame or frame.get(f"{name}Status", "OK") != "OK":
            part += 1  # a gap begins a new segment
            continue
        if "Timestamp" not in frame:
            raise InputError(f"frame {number} has no Timestamp: record it again")
        time.append(float(frame["Timestamp"]))
        matrices.append([float(word) for word in frame[name].split()])
        segment.append(part)
        if len(matrices[-1]) != 16 or matrices[-1][12:] != [0, 0, 0, 1]:
            raise InputError(f"frame {number}: a transform has 16 numbers, a rigid one")
    if not time:
        raise InputError("no frame has the status OK: was the target in view?")
    motions = np.array(matrices).reshape(-1, 4, 4)
    position = MILLIMETRE * motions[:, :3, 3]
    if not np.abs(motions).max() < 1e6:
        raise InputError("a transform is not finite or shifts beyond a kilometre")
    return Trajectory(
        np.array(time),
        position,
        motions[:, :3, :3].copy(),
        segment=np.unique(segment, return_inverse=True)[1].astype(np.int64),
    )
