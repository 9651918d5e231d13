"""The score of one rendering of one recording, and the aims."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.saved_results import restored
from ttus_opt.report.metrics import (
    FORCE_THRESHOLD,
    NOTICEABLE_FORCE,
    NOTICEABLE_SHARE,
    TORQUE_THRESHOLD,
    Evaluation,
    angles,
)

#: Largest mean angle of force [°], relative error of torque [–] and its angle [°]
AIM_ANGLE, AIM_TORQUE, AIM_TORQUE_ANGLE = 3.0, 0.15, 10.0

#: Fraction of the frames that counts as the worst [–]
WORST = 0.05


@dataclass(frozen=True)
class Score:
    """Errors over the frames in contact, unless said otherwise; names carry units.

    Attributes:
        force_magnitude_error_N: Mean |‖f‖ − ‖f̂‖| over all frames.
        force_angle_error_deg: Mean angle.
        torque_magnitude_error_Nm: Mean |‖τ‖ − ‖τ̂‖| over all frames.
        torque_angle_error_deg: Mean angle over frames with a torque.
        force_median_N: Median |‖f‖ − ‖f̂‖|.
        force_median_share: Median of the same over ‖f‖ [–].
        force_worst_N: |‖f‖ − ‖f̂‖| that the worst 5 % of frames exceed.
        angle_worst_deg: Angle that the worst 5 % of frames exceed.
        torque_share: Mean |‖τ‖ − ‖τ̂‖| over mean ‖τ‖, of frames with a torque [–].
        share_told_apart: See `report.metrics.Errors` [–].
        mean_force_N: Mean ‖f‖.
        frames_in_contact: Their number [–].
    """

    force_magnitude_error_N: float
    force_angle_error_deg: float
    torque_magnitude_error_Nm: float
    torque_angle_error_deg: float
    force_median_N: float
    force_median_share: float
    force_worst_N: float
    angle_worst_deg: float
    torque_share: float
    share_told_apart: float
    mean_force_N: float
    frames_in_contact: int

    @classmethod
    def of(cls, evaluation: Evaluation) -> Score:
        """The score of an evaluation; NaN where no frame is in contact."""
        errors = evaluation.errors
        size = np.linalg.norm(evaluation.measured_force, axis=1)
        touching = size > FORCE_THRESHOLD
        off = np.abs(np.linalg.norm(evaluation.rendered_force, axis=1) - size)[touching]
        turned = angles(evaluation.measured_force, evaluation.rendered_force)[touching]
        twist = np.linalg.norm(evaluation.measured_torque, axis=1)
        turning = touching & (twist > TORQUE_THRESHOLD)
        off_twist = np.abs(np.linalg.norm(evaluation.rendered_torque, axis=1) - twist)
        return cls(
            errors.force_magnitude_error_N,
            errors.force_angle_error_deg,
            errors.torque_magnitude_error_Nm,
            errors.torque_angle_error_deg,
            _quantile(off, 0.5),
            _quantile(off / size[touching], 0.5),
            _quantile(off, 1.0 - WORST),
            _quantile(turned, 1.0 - WORST),
            _ratio(off_twist[turning], twist[turning]),
            errors.share_told_apart,
            float(size[touching].mean()) if touching.any() else float("nan"),
            errors.frames_in_contact,
        )

    def meets(self) -> dict[str, bool]:
        """Whether each aim is reached, by name."""
        return {
            "force": self.force_median_share <= NOTICEABLE_SHARE
            or self.force_median_N <= NOTICEABLE_FORCE,
            "angle": self.force_angle_error_deg <= AIM_ANGLE,
            "torque": self.torque_share <= AIM_TORQUE,
            "torque angle": self.torque_angle_error_deg <= AIM_TORQUE_ANGLE,
        }


@dataclass(frozen=True)
class Row:
    """One setting on one recording of one patient.

    Attributes:
        patient: Name.
        recording: Name.
        seen: Whether the setting was fitted to it.
        setting: Name.
        against: Reference: ``measured`` (reported poses, noisy wrench) or ``true``
            (true poses, true wrench).
        score: Its errors.
    """

    patient: str
    recording: str
    seen: bool
    setting: str
    against: str
    score: Score

    def as_dict(self) -> dict[str, Any]:
        """Flat, for JSON."""
        key = {k: getattr(self, k) for k in _KEYS}
        return {**key, **asdict(self.score)}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Row:
        """Inverse of `as_dict`."""
        score = {k: v for k, v in values.items() if k not in _KEYS}
        return cls(**{k: values[k] for k in _KEYS}, score=restored(Score, score))


_KEYS = ("patient", "recording", "seen", "setting", "against")


def _quantile(values: Array, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else float("nan")


def _ratio(error: Array, size: Array) -> float:
    return float(error.mean() / size.mean()) if len(size) else float("nan")
