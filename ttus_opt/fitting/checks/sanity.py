"""Do recordings and geometry agree? A check for wrong signs, frames, units and delays.

A fit to forces of the wrong sign, frame or unit still converges. Measured wrenches are
therefore compared with those of the Laplace field alone, whose directions and contacts
follow from geometry. With f̂ = N p₀ and τ̂ = W p₀ of a few frames,

    S = √(S_f S_τ),  S_f = min_s ‖f - s f̂‖²/‖f‖²,  S_τ = min_k ‖τ - k τ̂‖²/‖τ‖²

with s, k ≥ 0 is small if they agree; with forces alone S = S_f. S is also computed for
the recordings read in other conventions (sign, frame, order, delay), and the smallest
value names the likely one. Comparing log S compares likelihoods of Gaussian residuals
with two unknown variances; with the sum of S_f and S_τ, torques that no convention
explains would hide the forces.

Torques about a point at c from the assumed one, in the frame R of the probe, differ by
the moment of the force, τ = k τ̂ - (R c) × f, with k τ̂ the expected torque. k and c
follow by least squares. A push along an axis of the probe does not determine c along
that axis: directions with small singular values are left at zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.checks.other_readings import Reading, other_readings
from ttus_opt.probe.conventions import Conventions
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.metrics import FORCE_THRESHOLD, evaluate, hysteresis_share
from ttus_opt.report.tables import number
from ttus_opt.voxmap.field import PotentialField

#: Most frames that are compared [–]
FRAMES = 120

#: Another convention is reported if its S is below this share of the recordings' own
CLEARLY = 0.7

#: Fewer frames agree with some convention by chance [–]
FEWEST = 4

#: Torques this many times too large are in N mm
WRONG_UNIT = 100.0

#: Least lever of expected torques that tell a unit, over the probe's rms radius: those
#: of a ball about its centre are rounding [–]
LEAST_LEVER = 0.01

#: Least and largest plausible offset of the point about which torques were measured [m]
FAR, FARTHEST = 0.01, 0.5

#: Hysteresis below this comes from noise and slow drift of the probe [–]
WORTH_TELLING = 0.05


@dataclass(frozen=True)
class RecordingCheck:
    """One recording compared with the fitted field and the geometry.

    Attributes:
        name: Name of the recording.
        frames: Number of frames [–].
        force_residual_N: Mean ‖f - f̂‖ [N].
        torque_residual_Nm: Mean ‖τ - τ̂‖; NaN without measured torques [N·m].
        force_angle_deg: Mean angle between f and f̂ in contact; NaN without any [°].
        force_without_contact: Frames with a measured force where no shell point is
            inside the patient [–].
        contact_without_force: Frames in contact by geometry without a measured force
            [–].
        beyond_inner: Frames with shell points beyond the inner layer [–].
        hysteresis_share: Share of the work of complete presses that is lost; NaN
            without any [–].
    """

    name: str
    frames: int
    force_residual_N: float
    torque_residual_Nm: float
    force_angle_deg: float
    force_without_contact: int
    contact_without_force: int
    beyond_inner: int
    hysteresis_share: float = math.nan

    def __str__(self) -> str:
        torque = f"{1e3 * self.torque_residual_Nm:.1f} mN m"
        if math.isnan(self.torque_residual_Nm):
            torque = "no torques"
        lost = ""
        if self.hysteresis_share >= WORTH_TELLING:
            lost = f", {100 * self.hysteresis_share:.0f} % hysteresis"
        return (
            f"{self.name}: {self.frames} frames, residual {self.force_residual_N:.2f} "
            f"N, {torque}, {number(self.force_angle_deg, '.1f')}°; "
            f"{self.force_without_contact} with force but no contact, "
            f"{self.contact_without_force} with contact but no force, "
            f"{self.beyond_inner} below the inner layer{lost}"
        )


@dataclass(frozen=True)
class Mistake:
    """A likely mistake in how the recordings were read.

    Attributes:
        what: Description.
        mends: The options of ``ttus-opt fit`` that correct it; empty for none.
        before: S of the recordings as read [–].
        after: S with these options; a unit does not change it [–].
        cause: What was mistaken: a field of `Conventions`, ``columns``, or axes.
    """

    what: str
    mends: str
    before: float
    after: float
    cause: str

    def __str__(self) -> str:
        return self.told(f"read them with {self.mends or 'none of those options'}")

    def told(self, remedy: str) -> str:
        """The mistake in a sentence, with a remedy."""
        if self.after == self.before:
            return f"{self.what}: {remedy}"
        return (
            f"{self.what}? Disagreement with the geometry {self.before:.2g} → "
            f"{self.after:.2g}: {remedy}"
        )


@dataclass(frozen=True)
class SanityReport:
    """Result of `check_recordings`.

    Attributes:
        recordings: One check per recording.
        shell_size: Edges of the shell's bounding box, probe frame, shape (3,) [m].
        shell_centroid: Area centroid, probe frame, shape (3,) [m].
        disagreement: S of the recordings as read, from 0 to 1 [–].
        mistake: The most likely mistake; None if nothing fits clearly better.
    """

    recordings: tuple[RecordingCheck, ...]
    shell_size: tuple[float, ...]
    shell_centroid: tuple[float, ...]
    disagreement: float
    mistake: Mistake | None

    def __repr__(self) -> str:
        result = "no mistake found" if self.mistake is None else self.mistake.what
        return (
            f"<SanityReport on {len(self.recordings)} recordings: disagreement "
            f"{self.disagreement:.2f}, {result}>"
        )

    @property
    def lines(self) -> list[str]:
        """The report as text."""
        size = " × ".join(f"{1e3 * v:.0f}" for v in self.shell_size)
        centroid = ", ".join(f"{1e3 * v:z.1f}" for v in self.shell_centroid)
        return [
            *map(str, self.recordings),
            f"probe: {size} mm, centroid at ({centroid}) mm of its frame",
        ]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def check_recordings(
    scene: Scene,
    field: PotentialField,
    names: Sequence[str] = (),
    *,
    written: Trajectory | None = None,
    conventions: Conventions | None = None,
) -> SanityReport:
    """Compare recordings with the fitted field and with the geometry.

    Args:
        scene: A scene with measured wrenches.
        field: The field fitted to it.
        names: Names of the recordings, one per segment; by default numbers.
        written: The recordings as in the files, read in the package's own
            conventions; by default the scene's.
        conventions: The conventions by which the scene's recordings were read from
            these; by default the package's own.

    Raises:
        InputError: The scene has no wrenches.
    """
    trajectory = scene.trajectory
    if not trajectory.has_wrench:
        raise InputError("the recordings have no wrenches to check")
    recordings = trajectory.recordings
    names = recording_names(names, len(recordings))
    checks = [
        _recording(scene, field, name, own)
        for name, own in zip(names, recordings, strict=True)
    ]
    shell = scene.shell
    disagreement, mistake = likely_mistake(
        scene, written or trajectory, conventions or Conventions()
    )
    return SanityReport(
        tuple(checks),
        tuple(np.ptp(shell.points, axis=0).tolist()),
        tuple(np.asarray(shell.reference).tolist()),
        disagreement,
        mistake,
    )


def recording_names(names: Sequence[str], n: int) -> Sequence[str]:
    """Names of n recordings, from those of their files.

    >>> recording_names(["press.csv"], 2)
    ['press.csv part 1', 'press.csv part 2']
    """
    if len(names) == n:
        return names
    if len(names) == 1:
        return [f"{names[0]} part {k + 1}" for k in range(n)]
    return [f"recording {k}" for k in range(n)]


def _recording(
    scene: Scene, field: PotentialField, name: str, recorded: Trajectory
) -> RecordingCheck:
    evaluation = evaluate(field, scene.shell, recorded)
    force = np.linalg.norm(evaluation.measured_force, axis=1) > FORCE_THRESHOLD
    contact = scene.rows_along(recorded).contact_points > 0
    return RecordingCheck(
        name,
        len(recorded),
        _mean_size(evaluation.measured_force - evaluation.rendered_force),
        _mean_size(evaluation.measured_torque - evaluation.rendered_torque),
        evaluation.errors.force_angle_error_deg,
        int((force & ~contact).sum()),
        int((contact & ~force).sum()),
        int((evaluation.beyond_inner > 0).sum()),
        hysteresis_share(recorded, scene.shell, FORCE_THRESHOLD),
    )


def likely_mistake(
    scene: Scene,
    written: Trajectory,
    conventions: Conventions,
    readings: Iterable[Reading] | None = None,
) -> tuple[float, Mistake | None]:
    """S as read, and a convention that agrees clearly better; None without one.

    None of fewer than `FEWEST` frames too.

    Args:
        scene: A scene with measured forces; its boundary values do not matter.
        written: As in `check_recordings`.
        conventions: As in `check_recordings`.
        readings: What to compare with; by default `other_readings`.
    """
    if readings is None:
        readings = other_readings(scene, written, conventions)
    frames = np.linspace(0, len(written) - 1, FRAMES)
    chosen = np.unique(frames.astype(np.int64))
    prior = scene.laplace.solve(scene.b)
    before, torque_ratio = agreement(scene, prior, scene.trajectory.select(chosen))
    if len(chosen) < FEWEST:
        return before, None
    bound = CLEARLY * before
    best: Mistake | None = None
    for what, mends, cause, reread in readings:
        # re-read as a whole: a delay needs neighbouring frames
        after, _ = agreement(scene, prior, reread.select(chosen))
        if after < bound:
            bound = after
            best = Mistake(what, mends, before, bound, cause)
    moved = _about_another_point(scene, prior, written, conventions, chosen)
    if moved is not None and moved[1] < (bound if best is None else CLEARLY * bound):
        reading, after = moved
        point = reading.point(np.asarray(scene.shell.reference))
        x, y, z = (round(1e3 * v) for v in point)
        what = f"torques about ({x}, {y}, {z}) mm of the probe's frame"
        best = Mistake(what, reading.options, before, after, "torque_about")
    elif best is None and conventions.torque_unit == "Nm" and torque_ratio > WRONG_UNIT:
        mends = replace(conventions, torque_unit="Nmm").options
        what = f"torques in N mm, {torque_ratio:.0f} times those expected"
        best = Mistake(what, mends, before, before, "torque_unit")
    return before, best


def _about_another_point(
    scene: Scene,
    prior: Array,
    written: Trajectory,
    conventions: Conventions,
    chosen: NDArray[np.int64],
) -> tuple[Conventions, float] | None:
    """The convention with the reference point that the torques determine, and its S.

    None without torques, or if that point is the assumed one.
    """
    frames = scene.trajectory.select(chosen)
    if frames.torque is None or frames.force is None:
        return None
    expected = (scene.rows_along(frames).W @ prior).reshape(-1, 3)
    c = torque_offset(frames.torque, expected, frames.force, frames.rotation)
    if not FAR < np.linalg.norm(c) < FARTHEST:
        return None
    centroid = np.asarray(scene.shell.reference)
    point = tuple((np.round(conventions.point(centroid) + c, 3) + 0.0).tolist())
    other = replace(conventions, torque_about=point)
    reread = other.read(written, centroid, scene.voxmap.surface.axis.scan_to_patient)
    return other, agreement(scene, prior, reread.select(chosen))[0]


def _mean_size(vectors: Array) -> float:
    return float(np.linalg.norm(vectors, axis=1).mean())


#: Least singular value of a direction of c, over the largest [–]
LEAST_SINGULAR_VALUE = 0.1


def agreement(scene: Scene, prior: Array, frames: Trajectory) -> tuple[float, float]:
    """S of some frames, and the ratio of measured to expected torques [–].

    `prior` is p₀, shape (V,).
    """
    rows = scene.rows_along(frames)
    assert frames.force is not None
    expected = rows.N @ prior, rows.W @ prior
    s, force_left = _scaled(frames.force.reshape(-1), expected[0])
    if frames.torque is None:
        return force_left, 0.0
    k, torque_left = _scaled(frames.torque.reshape(-1), expected[1])
    left = math.sqrt(force_left * torque_left)
    size, lever = map(np.linalg.norm, expected)
    told = s > 0.0 and lever > LEAST_LEVER * scene.shell.rms_radius * size
    return left, k / s if told else 0.0


def torque_offset(
    torque: Array, expected: Array, force: Array, rotation: Array
) -> Array:
    """Offset c of the point about which torques were measured.

    Args:
        torque: Measured torques, patient axes, shape (T, 3) [N·m].
        expected: Expected torques up to a factor, shape (T, 3).
        force: Measured forces on the probe, shape (T, 3) [N].
        rotation: Rotation, probe to patient, shape (T, 3, 3).

    Returns:
        c from the assumed point, probe frame, shape (3,) [m].
    """
    # f × (R c) per column of R
    arms = np.cross(force[:, None, :], np.swapaxes(rotation, 1, 2))
    columns = np.swapaxes(arms, 1, 2).reshape(-1, 3)
    flat, tau = expected.reshape(-1), torque.reshape(-1)
    size = float(np.linalg.norm(flat))
    if size > 0.0:  # project out what the factor k explains
        unit = flat / size
        tau = tau - unit * (unit @ tau)
        columns = columns - np.outer(unit, unit @ columns)
    offset, *_ = np.linalg.lstsq(columns, tau, rcond=LEAST_SINGULAR_VALUE)
    return np.asarray(offset)


def _scaled(measured: Array, expected: Array) -> tuple[float, float]:
    """The best scale ≥ 0, and ‖rest‖²/‖measured‖²; 1 where nothing is expected."""
    size, power = float(measured @ measured), float(expected @ expected)
    if size == 0.0 or power == 0.0:
        return 0.0, float(size > 0.0)
    scale = max(float(measured @ expected) / power, 0.0)
    rest = measured - scale * expected
    return scale, float(rest @ rest) / size
