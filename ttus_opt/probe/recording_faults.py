"""Everything that is wrong with a recording, in one error; steps that no hand makes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import FileError, MistakeWarning, counted, warn
from ttus_opt.probe.pose import QUATERNION_TOLERANCE
from ttus_opt.probe.raw_recording import COMPONENTS, RawRecording, complete

#: A step that differs from both its neighbours by more than this [m], than this
#: acceleration makes it [m/s²], and than so many times the median, is a jump
JUMP, BRISK, JUMPS = 0.01, 15.0, 10.0


def jumps(position: Array, time: Array) -> tuple[Mask, Array]:
    """Steps of a path that no hand or robot makes, given the steps around them.

    Args:
        position: Shape (T, 3) [m].
        time: Increasing, shape (T,) [s].

    Returns:
        Mask of the frames after such a step, shape (T,), and by how much every step
        differs from those before and after it, the lesser of both, shape (T,) [m].
    """
    off = np.zeros(len(time))
    if len(time) < 4:
        return off > 0.0, off
    steps = np.diff(time)
    off[1:] = unlike_neighbours(position, steps)
    plausible = np.maximum(JUMP, BRISK * np.r_[0.0, steps] ** 2)
    return off > np.maximum(plausible, JUMPS * np.median(off[1:])), off


def unlike_neighbours(path: Array, steps: Array) -> Array:
    """By how much every step of a path (T, 3) differs from those before and after it.

    The lesser of both, over steps of the time, shape (T - 1,).
    """
    change = np.diff(np.diff(path, axis=0) / steps[:, None], axis=0)
    size = np.pad(np.linalg.norm(change, axis=1), 1, mode="edge")
    return np.asarray(np.minimum(size[:-1], size[1:]) * steps)


#: Sizes above which numbers are in another unit where none is stated: [m], [N], [N·m];
#: of poses in a stated unit [m]; of wrenches without poses, which may be raw [N, N·m]
MOST_POSITION, MOST_FORCE, MOST_TORQUE = 10.0, 1e3, 1e2
FARTHEST, MOST_READING = 100.0, 1e5

#: Frames further apart than this are taken for times in milliseconds [s]
SLOW = 5.0

#: What is wrong with a recording of no rows
NO_FRAME = "no frame is valid: was the target in view?"

#: Most faults that an error lists
MOST_LISTED = 6


class Fault(NamedTuple):
    """One kind of fault.

    Attributes:
        rows: Where it is, shape (T,).
        what: The first one, in words.
        remedy: What to do.
        repairable: Whether `ttus_opt.probe.repair` removes it.
    """

    rows: Mask
    what: str
    remedy: str
    repairable: bool = True

    @property
    def first(self) -> int:
        """The first row."""
        return int(np.argmax(self.rows))

    def told(self) -> str:
        """What is wrong, and in how many more rows."""
        more = int(self.rows.sum()) - 1
        return f"{self.what} (and {more} more)" if more else self.what


def faults(raw: RawRecording) -> list[Fault]:
    """All that is wrong, in the order of the first rows."""
    found = [*_missing(raw), *_sizes(raw), *_times(raw), *_quaternions(raw)]
    return sorted(found, key=lambda fault: fault.first)


def checked(raw: RawRecording) -> RawRecording:
    """The recording with unit quaternions, its repeated rows left out with a warning.

    Raises:
        FileError: Anything is wrong with it; one line that lists it all.
    """
    if not len(raw):
        raise FileError(f"{raw.title}: {NO_FRAME}")
    new = new_rows(raw)
    if not new.all():
        rows = counted(int((~new).sum()), "row")
        warn(f"{raw.title}: {rows} equal to the row before left out", 2)
        raw = raw.select(new)
    found = faults(raw)
    if found:
        raise FileError(_listed(raw, found))
    _warn_of_milliseconds(raw)
    return unit_quaternions(raw)


def new_rows(raw: RawRecording) -> Mask:
    """Mask of the rows that do not repeat the row before, time included.

    A device that sends a reading twice does not measure twice.
    """
    rows, new = raw.rows(), np.ones(len(raw), bool)
    new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return new


def unit_quaternions(raw: RawRecording) -> RawRecording:
    """The recording with quaternions of unit length."""
    if raw.quaternion is None:
        return raw
    length = np.linalg.norm(raw.quaternion, axis=1, keepdims=True)
    return raw.replaced(quaternion=raw.quaternion / length)


def missing(raw: RawRecording) -> Mask:
    """Mask of the rows without a number somewhere, shape (T,)."""
    return ~complete(raw.rows())


def bad_quaternions(raw: RawRecording) -> Mask:
    """Mask of the rows whose quaternion is far from unit length, shape (T,)."""
    if raw.quaternion is None:
        return np.zeros(len(raw), bool)
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(raw.quaternion, axis=1)
    return np.asarray(np.abs(length - 1.0) > QUATERNION_TOLERANCE)


def _missing(raw: RawRecording) -> Iterator[Fault]:
    lost = missing(raw)
    if not lost.any():
        return
    row, names = int(np.argmax(lost)), [n for k in raw.arrays() for n in COMPONENTS[k]]
    values = raw.rows()[row]
    at = int(np.argmax(~np.isfinite(values)))
    what = raw.unread.get(row, f"{names[at]} is {values[at]}")
    thing = "line" if len(raw.line) else "frame"
    remedy = f"remove the {counted(int(lost.sum()), thing)} with missing values"
    if row in raw.unread:
        truncated = "truncated" in what
        remedy = "record or copy it again" if truncated else "repair or remove the line"
    yield Fault(lost, what, remedy)


def _sizes(raw: RawRecording) -> Iterator[Fault]:
    poses, stated = raw.has_poses, raw.units_stated
    far = FARTHEST if stated else MOST_POSITION
    most = (MOST_FORCE, MOST_TORQUE) if poses else (MOST_READING, MOST_READING)
    wrong = "check units"
    for values, limit, unit, remedy in (
        (raw.position, far, "m", "millimetres? divide by 1000"),
        (raw.force, most[0], "N", "millinewtons? convert to N"),
        (raw.torque, most[1], "N m", "N mm? divide by 1000"),
    ):
        if values is None:
            continue
        with np.errstate(invalid="ignore"):
            size = np.nan_to_num(np.abs(values), nan=0.0, posinf=0.0).max(axis=1)
        large = size > limit
        if large.any():
            what = f"{size[np.argmax(large)]:.6g} {unit} is not plausible"
            remedy = wrong if stated else remedy if poses else "counts? give the unit"
            yield Fault(large, f"{what} (over {limit:g})", remedy, False)


def _times(raw: RawRecording) -> Iterator[Fault]:
    time, steps = raw.time, raw.steps
    remedy = "sort by t and drop duplicates"
    for rows, kind in ((steps == 0, "repeats"), (steps < 0, "goes back from")):
        if rows.any():
            i = int(np.argmax(rows))
            what = f"time {time[i]:.9g} s {kind} {time[i - 1]:.9g} s"
            yield Fault(rows, what, remedy)


def _quaternions(raw: RawRecording) -> Iterator[Fault]:
    bad = bad_quaternions(raw)
    if raw.quaternion is None or not bad.any():
        return
    length = math.hypot(*raw.quaternion[np.argmax(bad)])  # squares may overflow
    if length < 1e-9:
        what = "the quaternion is zero"
        remedy = "that frame has no orientation, remove the line"
    else:
        what = f"the quaternion has length {length:.6g}, expected 1"
        remedy = "normalise qw,qx,qy,qz"
    yield Fault(bad, what, remedy)


def _listed(raw: RawRecording, found: list[Fault]) -> str:
    """One line: a single fault with its remedy, or all of them."""
    if len(found) == 1:
        (one,) = found
        told = f"{one.told()}: {one.remedy}{_advice(found)}"
        return f"{raw.title}, {raw.place(one.first)}: {told}"
    listed = "; ".join(f"{raw.place(f.first)}: {f.told()}" for f in found[:MOST_LISTED])
    return f"{raw.title} has {len(found)} kinds of faults: {listed}{_advice(found)}"


def _advice(found: list[Fault]) -> str:
    able = sum(fault.repairable for fault in found)
    if able == len(found):
        return ", or read it with repair=True"
    return "" if len(found) == 1 else ": correct them; ttus-opt doctor shows them"


def _warn_of_milliseconds(raw: RawRecording) -> None:
    steps = raw.steps[np.isfinite(raw.steps)]
    usual = float(np.median(steps)) if len(steps) else 0.0
    if raw.has_poses and not raw.units_stated and usual > SLOW:
        warn(
            f"{raw.title}: frames are {usual:.3g} s apart: are the times "
            "in milliseconds? divide t by 1000",
            3,
            MistakeWarning,
        )
