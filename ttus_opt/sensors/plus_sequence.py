"""Sequence files of PLUS and 3D Slicer: transforms, status and times of every frame.

The text before the pixels of a ``.mha``, ``.mhd`` or ``.nrrd`` has, for frame 12, lines
such as

    Seq_Frame0012_ProbeToTrackerTransform = 1 0 0 15.2 0 1 0 …
    Seq_Frame0012_ProbeToTrackerTransformStatus = OK
    Seq_Frame0012_Timestamp = 213.4

(``:=`` in a ``.nrrd``) with matrices row by row and translations in mm. Pixels are not
read.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.probe.pose import nearest_rotations, to_quaternions
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.probe.trajectory import Trajectory, trajectory_of
from ttus_opt.sensors.stream_format import StreamFormat, Wanted, chosen

SUFFIXES = (".mha", ".mhd", ".nrrd")

#: Most text before the pixels [byte]
LONGEST_TEXT = 200_000_000

LINE = re.compile(r"Seq_Frame(\d+)_(\w+?) *:?= *(.*)")

#: Unit of translations in PLUS [m]
MILLIMETRE = 1e-3

TRANSFORM = "Transform"


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
    wanted = Wanted(transform and transform.removesuffix(TRANSFORM), kind="poses")
    file = Path(path)
    found = _read(file, wanted)
    return trajectory_of(chosen(file, found, wanted, PLUS.word))


def _read(path: Path, wanted: Wanted) -> list[RawRecording]:
    """The file's transforms, or the one wanted; errors as `read_plus_sequence`."""
    file = io.existing_file(path, "PLUS sequence")
    frames = _frames(file)
    names = {name for frame in frames.values() for name in frame}
    known = sorted(n.removesuffix(TRANSFORM) for n in names if n.endswith(TRANSFORM))
    if not known:
        raise FileError(f"{file} has no transforms: not a PLUS sequence with tracking")
    name = wanted.name and wanted.name.removesuffix(TRANSFORM)
    out = []
    for each in known:
        try:
            if name in (None, each):
                out.append(_poses(file, frames, each))
            else:
                out.append(RawRecording(str(file), *_NOTHING, name=each))
        except (InputError, ValueError) as error:
            raise FileError(f"{file}, {each}: {error}") from error
    return out


_NOTHING = (np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))


def _frames(file: os.PathLike[str]) -> dict[int, dict[str, str]]:
    """Fields of every frame, by its number.

    Raises:
        FileError: Not a MetaImage or NRRD file.
    """
    frames: dict[int, dict[str, str]] = {}
    read, nrrd = 0, False
    with open(file, "rb") as stream:
        for line in iter(lambda: stream.readline(1_000_000), b""):
            read += len(line)
            text = line.decode("latin-1").strip()
            if read == len(line):
                nrrd = text.startswith("NRRD")
                if not nrrd and "=" not in text:
                    raise FileError(
                        f"{file} is not a MetaImage or NRRD file: expected a .mha, "
                        ".mhd or .nrrd"
                    )
            ended = not text if nrrd else text.startswith("ElementDataFile")
            if ended or read > LONGEST_TEXT:
                break
            found = LINE.fullmatch(text)
            if found and len(found[1]) < 10:
                frames.setdefault(int(found[1]), {})[found[2]] = found[3]
    return frames


def _poses(file: Path, frames: dict[int, dict[str, str]], name: str) -> RawRecording:
    """Poses of the frames with a valid transform.

    Raises:
        InputError: A transform is not rigid.
        ValueError: Text where numbers are expected.
    """
    key = f"{name}{TRANSFORM}"
    time, matrices = np.zeros(len(frames)), np.tile(np.eye(4), (len(frames), 1, 1))
    lost = np.zeros(len(frames), bool)
    for row, number in enumerate(sorted(frames)):
        frame = frames[number]
        if key not in frame or frame.get(f"{key}Status", "OK") != "OK":
            lost[row] = True
            continue
        if "Timestamp" not in frame:
            raise InputError(f"frame {number} has no Timestamp: record it again")
        time[row] = float(frame["Timestamp"])
        numbers = [float(word) for word in frame[key].split()]
        if len(numbers) != 16 or numbers[12:] != [0, 0, 0, 1]:
            raise InputError(f"frame {number}: a transform has 16 numbers, a rigid one")
        matrices[row] = np.reshape(numbers, (4, 4))
    if not np.abs(matrices).max(initial=0.0) < 1e6:
        raise InputError("a transform is not finite or shifts beyond a kilometre")
    rotation, worst = nearest_rotations(matrices[:, :3, :3])
    own, _, other = name.partition("To")
    raw = RawRecording(
        str(file),
        time,
        MILLIMETRE * matrices[:, :3, 3],
        to_quaternions(rotation),
        name=name,
        notes=(f"mm, {f'{own} in {other}' if other else 'no frame stated'}",),
        units_stated=True,
    ).without(lost, "not OK")
    if worst > 0.0:
        projected = f"rotations off by {worst:.1g} were projected to the nearest ones"
        raw = raw.replaced(cautions=(projected,))
    return raw


PLUS = StreamFormat(
    "sequence of PLUS or 3D Slicer",
    lambda file, head: file.suffix.lower() in SUFFIXES,
    _read,
    "transform",
)
