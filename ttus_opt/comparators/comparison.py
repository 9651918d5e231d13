"""Several comparators, fitted to the same recordings and evaluated on others.

Errors are those of `ttus_opt.report.metrics`. *Ripple* is the short-wave part of the
rendered force while the probe slides slowly along a straight line: root mean square of
the force minus its smooth part (a cubic over 10 mm), over its mean. Milliseconds depend
on machine and run: compare them within a table only. Comparators are discovered in this
folder.
"""

from __future__ import annotations

import functools
import inspect
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ttus_opt.comparators.base import Comparator, WrenchSource
from ttus_opt.core import plugins
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError, TtusError
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report import metrics
from ttus_opt.report.document import Table
from ttus_opt.scan.surface import Surface


@functools.cache
def _kinds() -> dict[str, type[Comparator]]:
    """Classes by the name they are made by."""
    classes = plugins.classes_of(sys.modules["ttus_opt.comparators"]).values()
    kinds = [kind for kind in classes if issubclass(kind, Comparator) and kind.name]
    return {kind.name: kind for kind in sorted(kinds, key=lambda kind: kind.name)}


def available() -> dict[str, str]:
    """Names of the comparators with their summaries."""
    return {name: kind.summary for name, kind in _kinds().items()}


def kind(name: str) -> type[Comparator]:
    """The class of a comparator.

    Raises:
        InputError: Unknown name.
    """
    kinds = _kinds()
    if name not in kinds:
        raise InputError(f"unknown comparator {name!r}: choose from {', '.join(kinds)}")
    return kinds[name]


def create(
    name: str,
    *,
    surface: Surface,
    shell: PointShell,
    cloud: Array | None = None,
    **options: Any,
) -> Comparator:
    """A comparator, not yet fitted.

    Args:
        name: One of `available`.
        surface: The patient.
        shell: The probe.
        cloud: Points of the surface, patient frame, for those that work on a cloud,
            shape (n, 3) [m]; by default the surface's nodes.
        options: Options of the comparator, see its class.

    Raises:
        InputError: Unknown name or option, or an invalid cloud.
    """
    made = kind(name)
    common = {"self", "given", "surface", "shell", "cloud"}
    known = set(inspect.signature(made.__init__).parameters) - common
    unknown = sorted(options.keys() - known)
    if unknown:
        raise InputError(
            f"{name} has no option {', '.join(unknown)}: it has "
            f"{', '.join(sorted(known)) or 'none'}"
        )
    return made(surface=surface, shell=shell, cloud=cloud, **options)


#: Length and speed of the slide, and the window of its smooth part
SLIDE, SPEED, WINDOW = 0.03, 0.01, 0.01  # [m], [m/s], [m]

#: Poses of the slide [–]
N_POSES = 301


@dataclass(frozen=True)
class Row:
    """One comparator on one unseen recording.

    Attributes:
        comparator: Its name.
        recording: The recording's name.
        force_magnitude_error_N: Mean |‖f‖ − ‖f̂‖|.
        force_angle_error_deg: Mean angle over frames in contact.
        torque_magnitude_error_Nm: Mean |‖τ‖ − ‖τ̂‖|.
        torque_angle_error_deg: Mean angle over frames with a torque.
        ms_per_frame: Processor time of a frame, see `timed_wrenches` [ms].
        ripple: Short waves of the force on a slow straight slide, over its mean [–].
        seconds_fit: Processor time of the fit [s].
        failure: Why there are no figures; empty otherwise.
    """

    comparator: str
    recording: str
    force_magnitude_error_N: float = math.nan
    force_angle_error_deg: float = math.nan
    torque_magnitude_error_Nm: float = math.nan
    torque_angle_error_deg: float = math.nan
    ms_per_frame: float = math.nan
    ripple: float = math.nan
    seconds_fit: float = math.nan
    failure: str = ""

    def as_dict(self) -> dict[str, float | str]:
        """The row by name, for JSON."""
        return asdict(self)


def compare(
    names: Sequence[str] | None,
    surface: Surface,
    shell: PointShell,
    fitted: Trajectory | Sequence[Trajectory],
    unseen: Mapping[str, Trajectory],
    *,
    cloud: Array | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[Row, ...]:
    """Fit each comparator and evaluate it on unseen recordings.

    Args:
        names: Names from `available`; None for all of them.
        surface: The patient.
        shell: The probe.
        fitted: Recordings to fit to.
        unseen: Recordings to evaluate on, by name.
        cloud: Points of the surface for those that work on a cloud, (n, 3) [m].
        progress: Called with each name as it begins.

    Returns:
        A row per comparator and recording, with the reason where a fit failed.

    Raises:
        InputError: An unknown name, or no unseen recording.
    """
    chosen = list(available()) if names is None else list(names)
    if not unseen:
        raise InputError("compare needs at least one unseen recording, got none")
    rows: list[Row] = []
    for name in chosen:
        if progress is not None:
            progress(name)
        comparator = create(name, surface=surface, shell=shell, cloud=cloud)
        begin = time.process_time()
        try:
            comparator.fit(fitted)
        except TtusError as error:
            rows += [Row(name, label, failure=str(error)) for label in unseen]
            continue
        spent = time.process_time() - begin
        rows += [
            judged(comparator, label, recording, spent)
            for label, recording in unseen.items()
        ]
    return tuple(rows)


def judged(
    comparator: WrenchSource,
    label: str,
    recording: Trajectory,
    seconds_fit: float = math.nan,
) -> Row:
    """Errors of one fitted comparator on one recording.

    Args:
        comparator: Fitted.
        label: The recording's name.
        recording: A recording with forces.
        seconds_fit: Processor time of the fit, for the row [s].

    Raises:
        InputError: The recording has no forces.
    """
    wrench, frame = timed_wrenches(comparator, recording)
    errors = metrics.compare(recording, metrics.as_rendered(wrench)).errors
    return Row(
        comparator.name,
        label,
        errors.force_magnitude_error_N,
        errors.force_angle_error_deg,
        errors.torque_magnitude_error_Nm,
        errors.torque_angle_error_deg,
        1e3 * frame,
        ripple(comparator, recording),
        seconds_fit,
    )


def timed_wrenches(
    comparator: WrenchSource, recording: Trajectory
) -> tuple[Array, float]:
    """Wrenches along a recording, and how long a frame takes.

    The time is that of the calling thread alone: after a fit, the threads of BLAS wait
    for more work in a loop, which doubles the processor time of the whole process.

    Args:
        comparator: Fitted.
        recording: At least one frame.

    Returns:
        The wrench of every frame, shape (n, 6) [N, N·m], and the time of a frame [s].
    """
    # what is done once is not timed: compiling, and the recording's smoothed motion
    comparator.wrenches(recording.select(slice(0, 1)))
    recording.twist()
    begin = time.thread_time()
    wrench = comparator.wrenches(recording)
    return wrench, (time.thread_time() - begin) / len(recording)


def ripple(comparator: WrenchSource, recording: Trajectory) -> float:
    """Ripple of the force on a slow straight slide (module's docstring).

    Args:
        comparator: Fitted.
        recording: The slide goes along z through the pose of its largest force.

    Returns:
        Root mean square of the short waves over the mean force [–]; NaN without force.
    """
    from scipy.signal import savgol_filter

    force = np.linalg.norm(comparator.wrenches(slow_slide(recording))[:, :3], axis=1)
    mean = float(force.mean())
    if mean == 0.0:
        return math.nan
    window = 2 * round(WINDOW / SLIDE * N_POSES / 2) + 1
    waves = force - savgol_filter(force, window, 3)
    return float(np.sqrt((waves**2).mean())) / mean


def slow_slide(recording: Trajectory) -> Trajectory:
    """Poses along z through the pose of a recording's largest force, at `SPEED`.

    Raises:
        InputError: The recording has no forces.
    """
    if recording.force is None:
        raise InputError("a slide goes through the largest force: there are none")
    firm = int(np.linalg.norm(recording.force, axis=1).argmax())
    along = np.linspace(-SLIDE / 2, SLIDE / 2, N_POSES)
    position = recording.position[firm] + along[:, None] * [0.0, 0.0, 1.0]
    rotation = np.repeat(recording.rotation[firm][None], N_POSES, axis=0)
    return Trajectory((along + SLIDE / 2) / SPEED, position, rotation)


def markdown(rows: Sequence[Row], reference: str = "eq10") -> str:
    """The rows as a Markdown table, the smallest force error first, times as ratios.

    Args:
        rows: Rows from `compare`.
        reference: The comparator whose mean time of a frame is 1; the fastest if it is
            not among the rows.
    """
    timed = [row for row in rows if not row.failure]
    if reference not in {row.comparator for row in timed} and timed:
        reference = min(timed, key=lambda row: row.ms_per_frame).comparator
    milliseconds = [row.ms_per_frame for row in timed if row.comparator == reference]
    unit = float(np.mean(milliseconds)) if milliseconds else math.nan
    recordings = list(dict.fromkeys(row.recording for row in rows))
    header = [" / ".join(recordings), "force [N]", "angle [°]", "torque [mN m]"]
    header += ["angle [°]", "ripple [%]", f"frame / {reference}"]
    body: list[list[str]] = []
    shares: dict[str, list[Row]] = {}
    for row in rows:
        shares.setdefault(row.comparator, []).append(row)
    for name, shown in sorted(shares.items(), key=lambda share: _error(share[1])):
        failures = {row.failure for row in shown if row.failure}
        if failures:
            body.append([f"`{name}`", "; ".join(sorted(failures)), *[""] * 5])
            continue
        cells = zip(*(_cells(row, unit) for row in shown), strict=True)
        body.append([f"`{name}`", *(" / ".join(c) for c in cells)])
    return str(Table(header, body))


def _error(rows: Sequence[Row]) -> float:
    """Mean error of the force's magnitude; infinite where there is none [N]."""
    mean = float(np.mean([row.force_magnitude_error_N for row in rows]))
    return math.inf if math.isnan(mean) else mean


def _cells(row: Row, unit: float) -> tuple[str, ...]:
    times = row.ms_per_frame / unit
    return (
        f"{row.force_magnitude_error_N:.2f}",
        f"{row.force_angle_error_deg:.1f}",
        f"{1e3 * row.torque_magnitude_error_Nm:.1f}",
        f"{row.torque_angle_error_deg:.0f}",
        f"{100 * row.ripple:.1g}",
        f"{times:.0f}" if times >= 10.0 else f"{times:.2g}",
    )
