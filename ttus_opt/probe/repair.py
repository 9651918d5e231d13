"""Holes of a recording mended, each mending said.

Rows without numbers and repeated rows are dropped, rows that came late are sorted, and
the recording is split where the device saw nothing or its poses jump: no velocity is
taken and no wrench interpolated over a split. Nothing is made up.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Mask
from ttus_opt.core.errors import FileError, counted, warn
from ttus_opt.probe.raw_recording import RawRecording, parts
from ttus_opt.probe.recording_faults import bad_quaternions, jumps, missing, new_rows

#: A pause longer than this [s], and than so many median steps, is a gap [–]
PAUSE, STEPS = 0.1, 5.0

#: A clock that goes back by more than this was set anew: another recording [s]
RESET = 1.0

#: Fewer frames between two splits tell nothing of a motion
LEAST_FRAMES = 3


def repaired(raw: RawRecording) -> tuple[RawRecording, tuple[str, ...]]:
    """The recording without its holes, and what was done, a phrase each.

    Args:
        raw: As read.

    Raises:
        FileError: Nothing is left.
    """
    done: list[str] = []

    def kept(raw: RawRecording, rows: Mask, what: str) -> RawRecording:
        if rows.all():
            return raw
        done.append(f"dropped {counted(int((~rows).sum()), 'row')} {what}")
        if not rows.any():
            raise FileError(f"{raw.title}: no row is left after repair: record again")
        return raw.select(rows)

    raw = kept(raw, ~missing(raw), "with missing values")
    raw = kept(raw, ~bad_quaternions(raw), "without a unit quaternion")
    raw = kept(raw, new_rows(raw), "equal to the row before")
    raw = _split(raw, raw.steps < -RESET, "where the clock was set back", done)
    raw = _sorted(raw, done)
    raw = kept(raw, raw.steps != 0, "with a repeated time stamp")
    before = len(parts(raw.segment))
    if raw.has_poses:  # wrenches alone are not split
        raw = _split(raw, gaps(raw), "at gaps", done)
        raw = _split(raw, _jumps(raw), "at jumps", done)
    if len(parts(raw.segment)) > before:
        runs = [np.full(p.stop - p.start, p.stop - p.start) for p in parts(raw.segment)]
        long = np.concatenate(runs) >= LEAST_FRAMES
        raw = kept(raw, long, "alone between two splits")
    return raw, tuple(done)


def repaired_aloud(raw: RawRecording) -> RawRecording:
    """The same, with a warning of what was done.

    Raises:
        FileError: Nothing is left.
    """
    mended, done = repaired(raw)
    if done:
        warn(f"{raw.title}: {', '.join(done)}", 2)
    return mended


def _split(raw: RawRecording, at: Mask, where: str, done: list[str]) -> RawRecording:
    """The recording with a new segment from each of the rows on."""
    if not at.any():
        return raw
    done.append(f"split {where} ({int(at.sum())})")
    new = at.copy()
    new[1:] |= np.diff(raw.segment) != 0
    return raw.replaced(segment=np.cumsum(new).astype(np.int64))


def _sorted(raw: RawRecording, done: list[str]) -> RawRecording:
    """The recording in the order of time, each segment by itself."""
    late = int((raw.steps < 0).sum())
    if not late:
        return raw
    done.append(f"sorted {counted(late, 'row')} that came late")
    # segments in the order in which they stand
    number = np.cumsum(np.diff(raw.segment, prepend=0) != 0)
    return raw.select(np.lexsort((raw.time, number)))


def gaps(raw: RawRecording) -> Mask:
    """Mask of the rows that come after a pause unlike the steps around it, (T,)."""
    steps = raw.steps
    usual = steps[steps > 0]
    middle = float(np.median(usual)) if len(usual) else 0.0
    return np.asarray(steps > max(PAUSE, STEPS * middle))


def _jumps(raw: RawRecording) -> Mask:
    out = np.zeros(len(raw), bool)
    assert raw.position is not None
    for part in parts(raw.segment):
        out[part], _ = jumps(raw.position[part], raw.time[part])
    return out
