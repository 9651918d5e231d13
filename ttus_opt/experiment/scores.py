"""The errors of one rendering of one recording, and the aims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ttus_opt.core.saved_results import restored
from ttus_opt.report.metrics import NOTICEABLE_FORCE, NOTICEABLE_SHARE, Errors

#: Largest mean angle of force [°], relative error of torque [–] and its angle [°]
AIM_ANGLE, AIM_TORQUE, AIM_TORQUE_ANGLE = 3.0, 0.15, 10.0


def meets(errors: Errors) -> dict[str, bool]:
    """Whether each aim is reached, by name."""
    return {
        "force": errors.force_median_share <= NOTICEABLE_SHARE
        or errors.force_median_N <= NOTICEABLE_FORCE,
        "angle": errors.force_angle_error_deg <= AIM_ANGLE,
        "torque": errors.torque_share <= AIM_TORQUE,
        "torque angle": errors.torque_angle_error_deg <= AIM_TORQUE_ANGLE,
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
    score: Errors

    def as_dict(self) -> dict[str, Any]:
        """Flat, for JSON."""
        return {**{k: getattr(self, k) for k in _KEYS}, **self.score.as_dict()}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Row:
        """Inverse of `as_dict`."""
        score = {k: v for k, v in values.items() if k not in _KEYS}
        return cls(**{k: values[k] for k in _KEYS}, score=restored(Errors, score))


_KEYS = ("patient", "recording", "seen", "setting", "against")
