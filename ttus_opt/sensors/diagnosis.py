"""What a stream of poses or wrenches is like, in figures a person asks for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import counted
from ttus_opt.probe.raw_recording import RawRecording, parts
from ttus_opt.probe.recording_faults import (
    MOST_FORCE,
    MOST_POSITION,
    NO_FRAME,
    SLOW,
    bad_quaternions,
    faults,
    jumps,
    missing,
)
from ttus_opt.probe.repair import gaps, repaired
from ttus_opt.scan.cloud import extent_words

T = TypeVar("T")

#: Noise of the second difference of white noise, and of its median absolute value
SECOND_DIFFERENCE, MEDIAN = 6.0**0.5, 1.4826

#: Less is the rounding of numbers [m, N, N·m]
ROUNDING = 1e-9

#: A lever longer than this makes torques of another unit likely [m]
LONGEST_LEVER = 2.0

#: Farther positions of a patient, robot or tracker are rather in mm than in cm
MOST_IN_CM = 60.0

#: Forces below this say nothing of the lever [N]
LEAST_FORCE = 0.5


@dataclass(frozen=True)
class Diagnosis:
    """A stream.

    Attributes:
        name: In its file; empty where it is the only one.
        holds: poses, wrenches, forces, or poses and wrenches.
        rows: Their number.
        rate: Median [Hz]; NaN for one row.
        seconds: From first to last [s].
        segments: Recordings in it.
        gaps: Number of pauses unlike the steps around them, and the longest [s].
        missing: Rows without a number somewhere.
        late: Rows whose time goes back.
        repeated: Rows whose time repeats the one before.
        jumps: Steps that no hand or robot makes.
        position: Least and largest of each axis, shape (2, 3) [m]; None without poses.
        turned: Largest rotation from the first pose [rad]; None without poses.
        force: Largest magnitude [N]; None without forces.
        torque: Largest magnitude [N·m]; None without torques.
        noise: Standard deviation of white noise on each, by name [m, N, N·m].
        notes: Units and frame as stated, then what was taken for granted.
        units: Doubts about units, each with its reason.
        faults: What is wrong, with the place of the first.
        repair: What `ttus_opt.probe.repair` would do.
    """

    name: str
    holds: str
    rows: int
    rate: float
    seconds: float
    segments: int
    gaps: tuple[int, float]
    missing: int
    late: int
    repeated: int
    jumps: int
    position: Array | None
    turned: float | None
    force: float | None
    torque: float | None
    noise: dict[str, float]
    notes: tuple[str, ...]
    units: tuple[str, ...]
    faults: tuple[str, ...]
    repair: tuple[str, ...]

    def facts(self) -> dict[str, Any]:
        """For JSON, with units in the names."""
        facts = asdict(self)
        number, longest = facts.pop("gaps")
        renamed = {
            "rate": "rate_Hz",
            "position": "position_m",
            "turned": "turned_rad",
            "force": "largest_force_N",
            "torque": "largest_torque_Nm",
        }
        return {renamed.get(k, k): v for k, v in facts.items()} | {
            "gaps": number,
            "longest_gap_s": longest,
        }

    def lines(self) -> list[str]:
        """As a person would say it."""
        named = f"{self.name}: " if self.name else ""
        several = f" in {self.segments} recordings" if self.segments > 1 else ""
        rate = "" if np.isnan(self.rate) else f", {self.rate:.4g} Hz"
        lines = [
            f"{named}{self.holds}, {counted(self.rows, 'row')} over "
            f"{self.seconds:.4g} s{several}{rate}"
        ]
        if self.position is not None and self.turned is not None:
            noise = 1e3 * self.noise["position"]
            lines.append(f"position {extent_words(self.position)} m")
            lines.append(
                f"rotation up to {np.rad2deg(self.turned):.0f}° from the first, noise "
                f"of positions {noise:.2g} mm"
            )
        for name, most, unit in (
            ("force", self.force, "N"),
            ("torque", self.torque, "N m"),
        ):
            if most is not None:
                lines.append(
                    f"{name} up to {most:.3g} {unit}, noise "
                    f"{self.noise[name]:.2g} {unit} a component"
                )
        if self.notes:
            lines.append(f"units and frame: {self.notes[0]}")
        lines += self.notes[1:]
        lines += [f"units? {doubt}" for doubt in self.units]
        number, longest = self.gaps
        if number:
            many = "gap of" if number == 1 else "gaps, the longest"
            lines.append(f"{number} {many} {longest:.3g} s")
        if self.jumps:
            lines.append(f"{counted(self.jumps, 'jump')} of the position")
        lines += [f"fault: {fault}" for fault in self.faults]
        if self.repair:
            lines.append(f"--repair: {', '.join(self.repair)}")
        elif not self.faults:
            lines.append("no faults")
        return lines


@np.errstate(over="ignore", invalid="ignore")  # numbers may be damaged
def diagnosis(raw: RawRecording) -> Diagnosis:
    """The figures of a stream, whatever is wrong with it."""
    lost = missing(raw) | bad_quaternions(raw)
    sound = raw.select(~lost)
    steps, paused = sound.steps, gaps(sound)
    usual = steps[steps > 0]
    kinds = [
        "poses" if raw.has_poses else "",
        "" if raw.force is None else "forces" if raw.torque is None else "wrenches",
    ]
    try:
        _, repair = repaired(raw)
    except OSError as error:
        repair = (str(error),)
    span = float(np.ptp(sound.time)) if len(sound) else 0.0
    return Diagnosis(
        raw.name,
        " and ".join(filter(None, kinds)) or "positions",
        len(raw),
        1.0 / float(np.median(usual)) if len(usual) else np.nan,
        span,
        len(parts(raw.segment)),
        (int(paused.sum()), float(steps[paused].max(initial=0))),
        int(missing(raw).sum()),
        int((steps < 0).sum()),
        int((steps == 0).sum()),
        _jumps(sound),
        _figure(sound.position, lambda v: np.stack([v.min(axis=0), v.max(axis=0)])),
        _figure(sound.quaternion, _turned),
        _figure(sound.force, _largest),
        _figure(sound.torque, _largest),
        _noise(sound),
        (*raw.notes, *raw.cautions),
        tuple(_doubts(sound, usual)),
        tuple(f"{raw.place(f.first)}: {f.told()}" for f in faults(raw))
        if len(raw)
        else (NO_FRAME,),
        repair,
    )


def _figure(values: Array | None, of: Callable[[Array], T]) -> T | None:
    return None if values is None or not len(values) else of(values)


def _turned(quaternion: Array) -> float:
    turns = Rotation.from_quat(quaternion, scalar_first=True)
    return float((turns * turns[0].inv()).magnitude().max())


def _sizes(vectors: Array) -> Array:
    """Lengths of the rows, shape (T,); squares may overflow."""
    return np.asarray(np.hypot.reduce(vectors, axis=1))


def _largest(values: Array) -> float:
    return float(_sizes(values).max())


def _jumps(sound: RawRecording) -> int:
    if sound.position is None:
        return 0
    count = 0
    for part in parts(sound.segment):
        time, position = sound.time[part], sound.position[part]
        new = np.r_[True, time[1:] > np.maximum.accumulate(time)[:-1]]
        count += int(jumps(position[new], time[new])[0].sum())
    return count


def _noise(sound: RawRecording) -> dict[str, float]:
    """White noise by second differences, which a smooth motion hardly has."""
    out = {}
    for name in ("position", "force", "torque"):
        values = getattr(sound, name)
        if values is not None:
            bend = np.abs(np.diff(values, 2, axis=0))
            middle = float(np.median(bend)) if len(bend) else 0.0
            noise = MEDIAN * middle / SECOND_DIFFERENCE
            out[name] = noise if noise > ROUNDING else 0.0
    return out


def _doubts(sound: RawRecording, steps: Array) -> list[str]:
    """Units that the numbers speak against, where the file states none."""
    if sound.units_stated or not len(sound):
        return []
    doubts = []
    if len(steps) and (step := float(np.median(steps))) > SLOW:
        doubts.append(f"rows are {step:.4g} s apart, so t is likely in ms: t=NAME[ms]")
    if sound.position is not None:
        size = float(np.median(_sizes(sound.position)))
        if size > MOST_POSITION:
            unit, other = ("mm", "") if size > MOST_IN_CM else ("cm", " (or mm)")
            doubts.append(
                f"positions are {size:.4g} m away in the median, so they are likely in "
                f"{unit}{other}: px=NAME[{unit}]"
            )
    if sound.force is not None:
        strength = _sizes(sound.force)
        if np.median(strength) > MOST_FORCE:
            doubts.append(
                f"forces are {np.median(strength):.4g} N in the median, so they are "
                "likely counts or mN: fx=NAME[mN], or a factor"
            )
        pressed = strength > LEAST_FORCE
        if sound.torque is not None and pressed.any():
            arm = _sizes(sound.torque[pressed]) / strength[pressed]
            if (lever := float(np.median(arm))) > LONGEST_LEVER:
                doubts.append(
                    f"torque over force is a lever of {lever:.3g} m in the median, so "
                    "torques are likely in N mm: tx=NAME[Nmm]"
                )
    return doubts
