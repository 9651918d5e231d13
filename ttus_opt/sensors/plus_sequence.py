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
from ttus_opt.sensors.stream_format import StreamFormat, Wanted

SUFFIXES = (".mha", ".mhd", ".nrrd")

#: Most text before the pixels [byte]
LONGEST_TEXT = 200_000_000

LINE = re.compile(r"Seq_Frame(\d+)_(\w+?) *:?= *(.*)")

#: Frames per second, where some program states them for the whole file
RATE = re.compile(r"\w*FrameRate *:?= *(\d+(?:\.\d*)?)\s*")

#: Times of a frame, the best first; older versions of PLUS also write the second
TIMES = ("Timestamp", "UnfilteredTimestamp")

#: Unit of translations in PLUS [m]
MILLIMETRE = 1e-3

TRANSFORM = "Transform"


def _read(path: Path, wanted: Wanted) -> list[RawRecording]:
    """The file's transforms, or the one wanted."""
    file = io.existing_file(path, "PLUS sequence")
    frames, rate = _frames(file)
    names = {name for frame in frames.values() for name in frame}
    known = sorted(n.removesuffix(TRANSFORM) for n in names if n.endswith(TRANSFORM))
    if not known:
        raise FileError(f"{file} has no transforms: not a PLUS sequence with tracking")
    name = wanted.name and wanted.name.removesuffix(TRANSFORM)
    out = []
    for each in known:
        try:
            if name in (None, each):
                # by the name that was given, with or without its last word
                poses = _poses(file, frames, each, rate)
                out.append(poses.replaced(name=wanted.name or each))
            else:
                out.append(RawRecording(str(file), *_NOTHING, name=each))
        except (InputError, ValueError) as error:
            raise FileError(f"{file}, {each}: {error}") from error
    return out


_NOTHING = (np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))


def _frames(file: os.PathLike[str]) -> tuple[dict[int, dict[str, str]], float | None]:
    """Fields of every frame, by its number, and the rate that the file states [Hz]."""
    frames: dict[int, dict[str, str]] = {}
    read, nrrd, rate = 0, False, None
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
            elif (stated := RATE.fullmatch(text)) and 0.1 < float(stated[1]) < 1e5:
                rate = float(stated[1])
    return frames, rate


def _times(
    frames: dict[int, dict[str, str]], rate: float | None
) -> tuple[dict[int, float], str]:
    """Time of each frame by its number [s], and what was taken for it, if anything."""
    for field in TIMES:
        if all(field in frame for frame in frames.values()):
            said = "" if field == TIMES[0] else f"times are the {field} of the frames"
            return {n: float(frame[field]) for n, frame in frames.items()}, said
    missing = min(n for n, frame in frames.items() if TIMES[0] not in frame)
    if rate is None:
        raise InputError(
            f"frame {missing} has no Timestamp, and the file no frame rate: record it "
            "again, or add a line 'FrameRate = 20' [Hz] after the file's first"
        )
    said = f"no times: frame numbers at {rate:g} Hz, the file's frame rate"
    return {n: n / rate for n in frames}, said


def _poses(
    file: Path, frames: dict[int, dict[str, str]], name: str, rate: float | None
) -> RawRecording:
    """Poses of the frames with a valid transform."""
    key = f"{name}{TRANSFORM}"
    time, matrices = np.zeros(len(frames)), np.tile(np.eye(4), (len(frames), 1, 1))
    lost = np.zeros(len(frames), bool)
    seen = {n: f for n, f in frames.items() if _valid(f, key)}
    times, said = _times(seen, rate) if seen else ({}, "")
    for row, number in enumerate(sorted(frames)):
        frame = frames[number]
        if not _valid(frame, key):
            lost[row] = True
            continue
        time[row] = times[number]
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
    if said:
        raw = raw.replaced(cautions=(*raw.cautions, said))
    return raw


def _valid(frame: dict[str, str], key: str) -> bool:
    return key in frame and frame.get(f"{key}Status", "OK") == "OK"


PLUS = StreamFormat(
    "sequence of PLUS or 3D Slicer",
    lambda file, head: file.suffix.lower() in SUFFIXES,
    _read,
    "transform",
)
