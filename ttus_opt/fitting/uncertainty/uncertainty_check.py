"""Calibration of stated uncertainty: coverage, and rank correlation with the error.

Rank correlations are computed over frames and over places. Within a place the stated
uncertainty follows the force, while errors need not; between places it reflects how
well each was measured. Errors within a place are alike, so that places, not frames, are
independent: the standard error of a correlation is that of the jackknife over places.

Source: B. Efron, C. Stein, The jackknife estimate of variance, Ann. Statist. 9 (1981).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ttus_opt.contact.places import places, runs
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.uncertainty.wrench_uncertainty import WrenchUncertainty
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.calibration_curve import CalibrationCurve, Spread
from ttus_opt.report.metrics import Evaluation

#: Fewest frames, or places, for a rank correlation [–]
LEAST = 3

#: 95 % of a normal distribution lie within so many standard deviations [–]
NORMAL = 1.959964


class StatesUncertainty(Protocol):
    """That of a fit (`Uncertainty`) or of a field file (`SavedUncertainty`)."""

    def std(self, trajectory: Trajectory) -> WrenchUncertainty:
        """Uncertainty of the wrenches rendered along a trajectory."""


@dataclass(frozen=True)
class Calibration:
    """Stated uncertainty compared with errors on a recording, over frames in contact.

    Rank correlations are Spearman's, with the length of the error. Figures of torque
    are NaN where none was measured, those over places with fewer than three.

    Attributes:
        force_std_N: Median standard deviation of the whole force, √ trace.
        torque_std_Nm: The same for torque.
        force_coverage: Share of measured force components within the 95 % interval of
            the field's uncertainty and the measurement noise together [–].
        torque_coverage: The same for torque [–].
        force_rank_correlation: With the field's own uncertainty [–].
        torque_rank_correlation: The same for torque [–].
        frames: Frames in contact.
        frames_unknown: Frames deeper than the uncertainty is known; left out.
        force_rank_error: Jackknife standard error of ``force_rank_correlation`` [–].
        torque_rank_error: The same for torque [–].
        force_total_rank_correlation: With uncertainty and noise together [–].
        torque_total_rank_correlation: The same for torque [–].
        force_place_rank_correlation: Rank correlation of the means over places [–].
        torque_place_rank_correlation: The same for torque [–].
        places: Runs of frames of one press within 30 mm [–].
        curve: Uncertainty and noise together against errors, to draw.
    """

    force_std_N: float
    torque_std_Nm: float
    force_coverage: float
    torque_coverage: float
    force_rank_correlation: float
    torque_rank_correlation: float
    frames: int
    frames_unknown: int = 0
    force_rank_error: float = np.nan
    torque_rank_error: float = np.nan
    force_total_rank_correlation: float = np.nan
    torque_total_rank_correlation: float = np.nan
    force_place_rank_correlation: float = np.nan
    torque_place_rank_correlation: float = np.nan
    places: int = 0
    curve: CalibrationCurve | None = field(default=None, repr=False, compare=False)

    def as_dict(self) -> dict[str, float]:
        """All figures by name, for JSON."""
        return {name: v for name, v in vars(self).items() if name != "curve"}


def check_uncertainty(
    uncertainty: StatesUncertainty, evaluation: Evaluation, trajectory: Trajectory
) -> Calibration:
    """Compare stated uncertainty with errors.

    Args:
        uncertainty: Uncertainty of the evaluated field.
        evaluation: Result of `ttus_opt.evaluate` on the trajectory.
        trajectory: A recording that was not fitted.

    Raises:
        InputError: The probe touches in fewer than three frames, or the evaluation is
            of another recording.
    """
    if not np.array_equal(evaluation.time, trajectory.time):
        raise InputError(
            "the evaluation belongs to another recording: pass the recording it was "
            "made on"
        )
    stated = uncertainty.std(trajectory)
    touching = stated.known & (stated.force_size > 0.0)
    if np.count_nonzero(touching) < LEAST:
        raise InputError(
            "a check of uncertainty needs three frames in contact, the recording has "
            "fewer"
        )
    press = runs(touching, trajectory.segment)[touching]
    place = places(press, trajectory.position[touching])
    found: dict[str, Any] = {
        "force_std_N": float(np.median(stated.force_size[touching])),
        "torque_std_Nm": np.nan,
        "torque_coverage": np.nan,
        "torque_rank_correlation": np.nan,
        "frames": int(touching.sum()),
        "frames_unknown": int((~stated.known).sum()),
        "places": int(place[-1]) + 1,
    }
    parts = {
        "force": (
            evaluation.rendered_force - evaluation.measured_force,
            stated.force,
            stated.force_noise,
        )
    }
    if np.isfinite(stated.torque_noise).all() and trajectory.has_torque:
        found["torque_std_Nm"] = float(np.median(stated.torque_size[touching]))
        off = evaluation.rendered_torque - evaluation.measured_torque
        parts["torque"] = off, stated.torque, stated.torque_noise
    spreads: dict[str, Spread] = {}
    for name, part in parts.items():
        error, std, noise = (values[touching] for values in part)
        spreads[name] = error, np.hypot(std, noise)
        figures = _figures(*spreads[name], std, place)
        found |= {f"{name}_{figure}": value for figure, value in figures.items()}
    curve = CalibrationCurve.of(spreads["force"], spreads.get("torque"))
    return Calibration(**found, curve=curve)


def _figures(
    error: Array, total: Array, std: Array, place: IntArray
) -> dict[str, float]:
    """From errors, their deviations with noise and without, (n, 3) each."""
    off, stated, whole = (np.linalg.norm(v, axis=1) for v in (error, std, total))
    frames = np.bincount(place)
    left = [_ranks(off[place != i], stated[place != i]) for i in range(len(frames))]
    jackknife = np.sqrt(max(len(left) - 1, 0)) * np.std(left)
    means = (np.bincount(place, values) / frames for values in (off, stated))
    return {
        "coverage": float((np.abs(error) <= NORMAL * total).mean()),
        "rank_correlation": _ranks(off, stated),
        "rank_error": float(jackknife) if len(left) >= LEAST else np.nan,
        "total_rank_correlation": _ranks(off, whole),
        "place_rank_correlation": _ranks(*means),
    }


def _ranks(a: Array, b: Array) -> float:
    """Spearman's rank correlation; NaN where it is undefined."""
    from scipy.stats import spearmanr

    if len(a) < LEAST or not (np.ptp(a) > 0.0 and np.ptp(b) > 0.0):
        return np.nan
    return float(spearmanr(a, b).statistic)
