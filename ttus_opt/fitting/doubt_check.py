"""Whether stated doubt holds: coverage, and whether the error grows with it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Protocol

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.fitting.posterior import NORMAL
from ttus_opt.fitting.wrench_doubt import WrenchDoubt
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.metrics import Evaluation


class StatesDoubt(Protocol):
    """What is checked: of a fit, or read from a field file."""

    def std(self, trajectory: Trajectory) -> WrenchDoubt:
        """How sure the field is of what it renders along a trajectory."""


@dataclass(frozen=True)
class Calibration:
    """Stated doubt against errors on a recording, over frames in contact.

    Attributes:
        force_std_N: Median standard deviation of the whole force, √ trace.
        torque_std_Nm: The same of torque; NaN where none was measured.
        force_coverage: Share of measured force components within the 95 % interval,
            the field's doubt and what a measurement shows beside it [–].
        torque_coverage: The same of torque; NaN where none was measured [–].
        force_rank_correlation: Spearman's, of the force's error with its doubt [–].
        torque_rank_correlation: The same of torque [–].
        frames: Frames in contact.
        frames_unknown: Frames that reach deeper than doubt is known; left out.
    """

    force_std_N: float
    torque_std_Nm: float
    force_coverage: float
    torque_coverage: float
    force_rank_correlation: float
    torque_rank_correlation: float
    frames: int
    frames_unknown: int = 0

    def as_dict(self) -> dict[str, float]:
        """All figures by name, for JSON."""
        return asdict(self)


def check_doubt(
    doubt: StatesDoubt, evaluation: Evaluation, trajectory: Trajectory
) -> Calibration:
    """Compare stated doubt with errors.

    Args:
        doubt: Of the field that was evaluated.
        evaluation: Of `ttus_opt.evaluate` on the trajectory.
        trajectory: A recording that was not fitted.

    Raises:
        InputError: The probe touches in fewer than three frames.
    """
    stated = doubt.std(trajectory)
    touching = stated.known & (stated.force_size > 0.0)
    if np.count_nonzero(touching) < 3:
        raise InputError(
            "doubt is checked on frames in contact, the recording has fewer than three"
        )
    force = _against(
        (evaluation.rendered_force - evaluation.measured_force)[touching],
        stated.force[touching],
        stated.force_noise[touching],
    )
    torque, torque_std = (np.nan, np.nan), np.nan
    if np.isfinite(stated.torque_noise).all() and trajectory.has_torque:
        torque_std = float(np.median(stated.torque_size[touching]))
        torque = _against(
            (evaluation.rendered_torque - evaluation.measured_torque)[touching],
            stated.torque[touching],
            stated.torque_noise[touching],
        )
    return Calibration(
        float(np.median(stated.force_size[touching])),
        torque_std,
        *(force[0], torque[0], force[1], torque[1]),
        int(touching.sum()),
        int((~stated.known).sum()),
    )


def _against(error: Array, std: Array, noise: Array) -> tuple[float, float]:
    """Coverage, and rank correlation of sizes."""
    from scipy.stats import spearmanr

    within = np.abs(error) <= NORMAL * np.sqrt(std**2 + noise**2)
    sizes = np.linalg.norm(error, axis=1), np.linalg.norm(std, axis=1)
    return float(within.mean()), float(spearmanr(*sizes).statistic)
