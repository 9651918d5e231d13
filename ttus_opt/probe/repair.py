"""Holes of a recording mended, each mending said.

Rows without numbers and repeated rows are dropped, rows that came late are sorted, and
the recording is split where the device saw nothing or its poses jump: no velocity is
taken and no wrench interpolated over a split. Nothing is made up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.core.errors import FileError, warn
from ttus_opt.probe.raw_recording import RawRecording, parts
from ttus_opt.probe.recording_faults import bad_quaternions, jumps, missing, new_rows

#: A pause longer than this [s], and than so many median steps, is a gap [–]
PAUSE, STEPS = 0.1, 5.0

#: A clock that goes back by more than this was set anew: another recording [s]
RESET = 1.0

#: Fewer frames between two splits tell nothing of a motion
LEAST_FRAMES = 3


class Repaired(NamedTuple):
    """A repaired recording.

    Attributes:
        recording: What is left.
        done: What was done, a phrase each; empty where nothing was.
    """

    recording: RawRecording
    done: tuple[str, ...]


def repaired(raw: RawRecording) -> Repaired:
    """The recording without its holes.

    Args:
        raw: As read.

    Raises:
        FileError: Nothing is left.
    """
    done: list[str] = []

    def kept(raw: RawRecording, rows: Mask, what: str) -> RawRecording:
        if rows.all():
            return raw
        done.append(f"dropped {_count(int((~rows).sum()))} {what}")
        if not rows.any():
            raise FileError(f"{raw.title}: no row is left after repair: record again")
        return raw.select(rows)

    raw = kept(raw, ~missing(raw), "with missing values")
    raw = kept(raw, ~bad_quaternions(raw), "without a unit quaternion")
    raw = kept(raw, new_rows(raw), "equal to the row before")
    raw = _split(raw, _resets(raw), "where the clock was set back", done)
    raw = _sorted(raw, done)
    raw = kept(raw, _first_stamps(raw), "with a repeated time stamp")
    before = len(parts(raw.segment))
    raw = _split(raw, _gaps(raw), "at gaps", done)
    raw = _split(raw, _jumps(raw), "at jumps", done)
    if len(parts(raw.segment)) > before:
        lonely = ~_in_short_parts(raw)
        if lonely.any():
            raw = kept(raw, lonely, "alone between two splits")
    return Repaired(raw, tuple(done))


def repaired_aloud(raw: RawRecording) -> RawRecording:
    """The same, with a warning of what was done.

    Raises:
        FileError: Nothing is left.
    """
    found = repaired(raw)
    if found.done:
        warn(f"{raw.title}: {', '.join(found.done)}", 2)
    return found.recording


def _count(n: int) -> str:
    return f"{n:,} row{'s' * (n != 1)}"


def _split(raw: RawRecording, at: Mask, where: str, done: list[str]) -> RawRecording:
    """The recording with a new segment from each of the rows on."""
    if not at.any():
        return raw
    done.append(f"split {where} ({int(at.sum())})")
    new = at.copy()
    new[1:] |= np.diff(raw.segment) != 0
    return raw.replaced(segment=np.cumsum(new).astype(np.int64))


def _resets(raw: RawRecording) -> Mask:
    back = (np.diff(raw.time) < -RESET) & (np.diff(raw.segment) == 0)
    return np.asarray(np.r_[False, back], dtype=bool)


def _sorted(raw: RawRecording, done: list[str]) -> RawRecording:
    """The recording in the order of time, each segment by itself."""
    late = int(((np.diff(raw.time) < 0) & (np.diff(raw.segment) == 0)).sum())
    if not late:
        return raw
    done.append(f"sorted {_count(late)} that came late")
    order: IntArray = np.lexsort((raw.time, _numbers(raw.segment)))
    return raw.select(order)


def _numbers(segment: IntArray) -> IntArray:
    """Segments numbered in the order in which they stand."""
    new = np.r_[True, np.diff(segment) != 0]
    return np.asarray(np.cumsum(new), dtype=np.int64)


def _first_stamps(raw: RawRecording) -> Mask:
    again = (np.diff(raw.time) == 0) & (np.diff(raw.segment) == 0)
    return np.asarray(~np.r_[False, again], dtype=bool)


def _gaps(raw: RawRecording) -> Mask:
    """Mask of the rows after a gap; wrenches alone are not split."""
    return gaps(raw.time, raw.segment) if raw.has_poses else np.zeros(len(raw), bool)


def gaps(time: Array, segment: IntArray) -> Mask:
    """Mask of the rows that come after a pause unlike the steps around it, (T,)."""
    out, together = np.zeros(len(time), bool), np.diff(segment) == 0
    steps = np.diff(time)
    usual = steps[together & (steps > 0)]
    if len(usual):
        pause = max(PAUSE, STEPS * float(np.median(usual)))
        out[1:] = together & (steps > pause)
    return out


def _jumps(raw: RawRecording) -> Mask:
    out = np.zeros(len(raw), bool)
    if raw.has_poses and raw.position is not None:
        for part in parts(raw.segment):
            out[part], _ = jumps(raw.position[part], raw.time[part])
    return out


def _in_short_parts(raw: RawRecording) -> Mask:
    out = np.zeros(len(raw), bool)
    for part in parts(raw.segment):
        out[part] = part.stop - part.start < LEAST_FRAMES
    return out
