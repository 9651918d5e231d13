"""Errors of a field against measured wrenches (tables I-IV of the paper).

A magnitude error is the mean of |‖f‖ - ‖f̂‖| over all frames; a direction error is the
mean angle over the frames in contact, where a direction exists.

Hysteresis is the share of the work of recorded presses that is dissipated. The work
done on the patient between two frames is the trapezoidal integral of −f·dx − τ·dφ,
where dx is the displacement of the torques' reference point and dφ the rotation. From
touch to release, an elastic body returns all of this work; tissue, gel and friction
dissipate part of it.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, label

from ttus_opt.core.arguments import expect
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.haptic.field_wrench import FieldWrenches, wrenches_along
from ttus_opt.haptic.motion import ways_along
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.voxmap.field import PotentialField

#: A frame is in contact above this measured force [N]
FORCE_THRESHOLD = 0.5

#: A torque's direction is used above this torque (3 σ of a good sensor) [N·m]
TORQUE_THRESHOLD = 0.01


#: Just noticeable differences of a force: 7 % of its magnitude (from 2.5 to 10 N) and
#: 0.36 N, 18 to 26° of its direction; relative [–], absolute [N], direction [°]
NOTICEABLE_SHARE, NOTICEABLE_FORCE, NOTICEABLE_ANGLE = 0.07, 0.36, 18.0

#: Fraction of the frames that counts as the worst [–]
WORST = 0.05


@dataclass(frozen=True)
class Errors:
    """Summary of an evaluation; names carry the units.

    Attributes:
        force_magnitude_error_N: Mean |‖f‖ - ‖f̂‖|.
        force_magnitude_rmse_N: Root mean square of ‖f‖ - ‖f̂‖.
        force_vector_rmse_N: Root mean square of ‖f - f̂‖.
        force_angle_error_deg: Mean angle over frames in contact; NaN without any.
        torque_magnitude_error_Nm: Mean |‖τ‖ - ‖τ̂‖|; NaN, like all errors of torque,
            without measured torques.
        torque_magnitude_rmse_Nm: Root mean square of ‖τ‖ - ‖τ̂‖.
        torque_angle_error_deg: Mean angle over frames with a torque; NaN without any.
        frames: Number of frames T.
        frames_in_contact: Number of frames with ‖f‖ above ``force_threshold_N``.
        frames_with_torque: Number of these with ‖τ‖ above ``torque_threshold_Nm``.
        force_threshold_N: Threshold of the force.
        torque_threshold_Nm: Threshold of the torque.
        share_told_apart: Fraction of the frames with a measured or rendered force above
            ``force_threshold_N`` in which a person could notice the difference
            (`noticeable`); NaN without any.
        force_median_N: Median |‖f‖ - ‖f̂‖| over frames in contact, as all that follow.
        force_median_share: Median of the same over ‖f‖ [–].
        force_worst_N: |‖f‖ - ‖f̂‖| that the worst 5 % of frames exceed.
        angle_worst_deg: Angle that the worst 5 % of frames exceed.
        torque_share: Mean |‖τ‖ - ‖τ̂‖| over mean ‖τ‖, frames with a torque [–].
        mean_force_N: Mean ‖f‖.
    """

    force_magnitude_error_N: float
    force_magnitude_rmse_N: float
    force_vector_rmse_N: float
    force_angle_error_deg: float
    torque_magnitude_error_Nm: float
    torque_magnitude_rmse_Nm: float
    torque_angle_error_deg: float
    frames: int
    frames_in_contact: int
    frames_with_torque: int
    force_threshold_N: float
    torque_threshold_Nm: float
    share_told_apart: float = math.nan
    force_median_N: float = math.nan
    force_median_share: float = math.nan
    force_worst_N: float = math.nan
    angle_worst_deg: float = math.nan
    torque_share: float = math.nan
    mean_force_N: float = math.nan

    def as_dict(self) -> dict[str, float]:
        """All values by name, for JSON."""
        return asdict(self)

    def __repr__(self) -> str:
        return (
            f"Errors(force {self.force_magnitude_error_N:.3g} N, "
            f"{self.force_angle_error_deg:.1f}°; torque "
            f"{1e3 * self.torque_magnitude_error_Nm:.3g} mN m, "
            f"{self.torque_angle_error_deg:.1f}°; {self.frames} frames, "
            f"{self.frames_in_contact} in contact)"
        )


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Measured and rendered wrenches of a trajectory.

    Attributes:
        errors: Summary of the errors.
        time: Shape (T,) [s].
        measured_force: Shape (T, 3) [N].
        rendered_force: Shape (T, 3) [N].
        measured_torque: Shape (T, 3) [N·m]; NaN where only forces were measured.
        rendered_torque: Shape (T, 3) [N·m].
        in_grid: Whether the pose lies within the grid, shape (T,).
        beyond_inner: Number of contact points beyond the field's inner layer, (T,) [–].
    """

    errors: Errors
    time: Array = field(repr=False)
    measured_force: Array = field(repr=False)
    rendered_force: Array = field(repr=False)
    measured_torque: Array = field(repr=False)
    rendered_torque: Array = field(repr=False)
    in_grid: NDArray[np.bool_] = field(repr=False)
    beyond_inner: NDArray[np.int64] = field(repr=False)

    def over(self, frames: slice | NDArray[np.bool_]) -> Evaluation:
        """The same of some of the frames, at least one."""
        some = {k: each[frames] for k, each in vars(self).items() if k != "errors"}
        measured = some["measured_force"], some["measured_torque"]
        rendered = some["rendered_force"], some["rendered_torque"]
        thresholds = self.errors.force_threshold_N, self.errors.torque_threshold_Nm
        return Evaluation(_errors(*measured, *rendered, thresholds), **some)


def evaluate(
    potential: PotentialField,
    shell: PointShell,
    trajectory: Trajectory,
    *,
    force_threshold: float = FORCE_THRESHOLD,
    torque_threshold: float = TORQUE_THRESHOLD,
) -> Evaluation:
    """Render a trajectory and compare it with the measured wrenches.

    The wrench is that of `ttus_opt.haptic.field_wrench`, the same as a renderer's: drag
    that was fitted is computed from the motion.

    Args:
        potential: The field.
        shell: The probe.
        trajectory: Poses with wrenches, or with forces alone.
        force_threshold: Measured force above which a frame is in contact [N].
        torque_threshold: Measured torque above which its direction is used [N·m].

    Raises:
        InputError: The trajectory has no forces, or an argument has another type.
    """
    expect(potential, PotentialField, "the field")
    expect(shell, PointShell, "the probe")
    expect(trajectory, Trajectory, "the recording")
    return compare(
        trajectory,
        wrenches_along(potential, shell, trajectory),
        force_threshold=force_threshold,
        torque_threshold=torque_threshold,
    )


def compare(
    trajectory: Trajectory,
    rendered: FieldWrenches,
    *,
    force_threshold: float = FORCE_THRESHOLD,
    torque_threshold: float = TORQUE_THRESHOLD,
) -> Evaluation:
    """Compare rendered with measured wrenches, the last step of `evaluate`.

    Raises:
        InputError: The trajectory has no forces.
    """
    if trajectory.force is None:
        raise InputError(
            "the trajectory has no wrench to compare with: add fx,fy,fz, and tx,ty,tz "
            "where torques were measured"
        )
    torque = trajectory.torque
    if torque is None:
        torque = np.full_like(trajectory.force, np.nan)
    wrenches = trajectory.force, torque, rendered.force, rendered.torque
    return Evaluation(
        _errors(*wrenches, (force_threshold, torque_threshold)),
        trajectory.time,
        trajectory.force,
        rendered.force,
        torque,
        rendered.torque,
        rendered.in_grid,
        rendered.beyond_inner,
    )


def as_rendered(wrench: Array) -> FieldWrenches:
    """Wrenches of another source, shape (T, 6) [N, N·m], for `compare`."""
    n = len(wrench)
    within, none = np.ones(n, dtype=bool), np.zeros(n, dtype=np.int64)
    return FieldWrenches(wrench[:, :3], wrench[:, 3:], within, none)


def angles(a: Array, b: Array) -> Array:
    """Angles between vectors of shape (T, 3), 90° where one of them is zero [°].

    >>> angles(np.array([[1.0, 0, 0]]), np.array([[1.0, 1, 0]])).round(3).item()
    45.0
    """
    # atan2 of sine and cosine is accurate for small angles, where arccos is not
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    cosine = np.einsum("ti,ti->t", a, b)
    turned = np.degrees(np.arctan2(sine, cosine))
    return np.where((sine == 0.0) & (cosine == 0.0), 90.0, turned)


def _errors(
    force: Array,
    torque: Array,
    force_hat: Array,
    torque_hat: Array,
    thresholds: tuple[float, float],
) -> Errors:
    force_threshold, torque_threshold = thresholds
    size, size_torque = np.linalg.norm(force, axis=1), np.linalg.norm(torque, axis=1)
    d_force = np.linalg.norm(force_hat, axis=1) - size
    d_torque = np.linalg.norm(torque_hat, axis=1) - size_torque
    touching = size > force_threshold
    turning = touching & (size_torque > torque_threshold)
    turned, off = angles(force, force_hat), np.abs(d_force[touching])
    present = touching | (np.linalg.norm(force_hat, axis=1) > force_threshold)
    felt = noticeable(force, force_hat, np.where(touching, turned, 0.0))
    return Errors(
        float(np.abs(d_force).mean()),
        float(np.sqrt((d_force**2).mean())),
        float(np.sqrt(((force - force_hat) ** 2).sum(axis=1).mean())),
        _mean(turned[touching]),
        float(np.abs(d_torque).mean()),
        float(np.sqrt((d_torque**2).mean())),
        _mean(angles(torque, torque_hat)[turning]),
        len(force),
        int(touching.sum()),
        int(turning.sum()),
        force_threshold,
        torque_threshold,
        _mean(felt[present]),
        _quantile(off, 0.5),
        _quantile(off / size[touching], 0.5),
        _quantile(off, 1.0 - WORST),
        _quantile(turned[touching], 1.0 - WORST),
        _mean(np.abs(d_torque[turning])) / _mean(size_torque[turning]),
        _mean(size[touching]),
    )


def _mean(values: Array) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _quantile(values: Array, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else float("nan")


def noticeable(force: Array, force_hat: Array, angle: Array) -> NDArray[np.bool_]:
    """Whether a person could notice the difference between two forces.

    Args:
        force: Measured force, shape (T, 3) [N].
        force_hat: Rendered force, shape (T, 3) [N].
        angle: Angle between them, 0 where undefined, shape (T,) [°].

    Returns:
        True where the magnitudes differ by more than both of their limits, or the
        directions by more than theirs, shape (T,).

    >>> f, g = np.array([[10.0, 0, 0]]), np.array([[10.5, 0, 0]])
    >>> noticeable(f, g, np.zeros(1)).item(), noticeable(f, g, np.full(1, 19.0)).item()
    (False, True)
    """
    size = np.linalg.norm(force, axis=1)
    error = np.abs(np.linalg.norm(force_hat, axis=1) - size)
    larger = np.maximum(NOTICEABLE_FORCE, NOTICEABLE_SHARE * size)
    return np.asarray((error > larger) | (angle > NOTICEABLE_ANGLE))


#: Shortest press that counts [frames]
SHORTEST = 5


def hysteresis_share(
    trajectory: Trajectory, shell: PointShell, force_threshold: float
) -> float:
    """Fraction of the work of complete presses that is dissipated.

    Args:
        trajectory: Poses with forces, and with torques if they were measured.
        shell: The probe.
        force_threshold: Force above which the probe is in contact [N].

    Returns:
        Σ work at release / Σ largest work during a press: 0 for an elastic body, 1 if
        all work is dissipated, NaN if no press begins and ends in the recording.

    Raises:
        InputError: The trajectory has no forces.
    """
    if trajectory.force is None:
        raise InputError("hysteresis needs measured forces: add fx,fy,fz")
    dissipated, done = 0.0, 0.0
    for own in trajectory.recordings:
        work = np.concatenate([[0.0], np.cumsum(_work(own, shell))])
        size = np.linalg.norm(np.asarray(own.force), axis=1)
        for start, stop in _presses(size > force_threshold):
            during = work[start : stop + 1] - work[start]
            dissipated, done = dissipated + during[-1], done + during.max()
    return dissipated / done if done > 0.0 else float("nan")


def _work(trajectory: Trajectory, shell: PointShell) -> Array:
    """Work done on the patient between frames, shape (T - 1,) [J]."""
    force, torque = trajectory.force, trajectory.torque
    assert force is not None
    wrench = force if torque is None else np.concatenate([force, torque], axis=1)
    ways = ways_along(shell, trajectory)[:, : wrench.shape[1]]
    return np.asarray(-np.einsum("ti,ti->t", wrench[1:] + wrench[:-1], ways) / 2)


def _presses(touching: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Last frame before and first frame after every complete press."""
    within = [own for (own,) in find_objects(label(touching)[0])]
    around = [(own.start - 1, own.stop) for own in within if own.start > 0]
    whole = [(a, b) for a, b in around if b < len(touching)]
    return [(a, b) for a, b in whole if b - a > SHORTEST]
