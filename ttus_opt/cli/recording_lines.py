"""What `ttus-opt evaluate` reports of each recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ttus_opt.core.errors import InputError

if TYPE_CHECKING:
    from ttus_opt.fitting.uncertainty.saved_uncertainty import SavedUncertainty
    from ttus_opt.fitting.uncertainty.uncertainty_check import Calibration
    from ttus_opt.probe.point_shell import PointShell
    from ttus_opt.probe.trajectory import Trajectory
    from ttus_opt.report.calibration_curve import CalibrationCurve
    from ttus_opt.report.metrics import Errors, Evaluation


@dataclass(frozen=True)
class RecordingLine:
    """One recording.

    Attributes:
        name: Name of the recording.
        frames: Its frames [–].
        hysteresis_share: Work of presses that is not given back; NaN without any.
        uncertainty: Stated uncertainty against errors; None if not requested.
        refused: Why the requested uncertainty is missing; "" otherwise.
        curve: The same comparison as curves; None without uncertainty.
        errors: Errors of its frames.
    """

    name: str
    frames: int
    hysteresis_share: float
    uncertainty: Calibration | None = None
    refused: str = ""
    curve: CalibrationCurve | None = None
    errors: Errors | None = None

    def as_dict(self) -> dict[str, Any]:
        """For JSON; with ``uncertainty`` only if requested."""
        facts: dict[str, Any] = {
            "name": self.name,
            "frames": self.frames,
            "hysteresis_share": self.hysteresis_share,
            "errors": None if self.errors is None else self.errors.as_dict(),
        }
        if self.uncertainty is not None or self.refused:
            facts["uncertainty"] = (
                None if self.uncertainty is None else self.uncertainty.as_dict()
            )
        if self.refused:
            facts["uncertainty_refused"] = self.refused
        return facts

    @property
    def lines(self) -> list[str]:
        """As text; empty if there is nothing to report."""
        lines = []
        if not math.isnan(self.hysteresis_share):
            lines.append(
                f"{self.name}: its presses lose {100 * self.hysteresis_share:.0f} % "
                "of their work to hysteresis"
            )
        if self.refused:
            lines.append(f"{self.name}: no uncertainty: {self.refused}")
        if self.uncertainty is not None:
            lines += self._uncertainty_lines(self.uncertainty)
        return lines

    def _uncertainty_lines(self, found: Calibration) -> list[str]:
        torque = not math.isnan(found.torque_std_Nm)
        unknown = found.frames_unknown
        line = (
            f"{self.name}: uncertainty {found.force_std_N:.3f} N"
            + (f", {1e3 * found.torque_std_Nm:.1f} mN m" if torque else "")
            + " in the median; the 95 % interval covers "
            + f"{100 * found.force_coverage:.1f} % of force"
            + (f" and {100 * found.torque_coverage:.1f} % of torque" if torque else "")
            + " components"
        )
        force = _with_error(found.force_rank_correlation, found.force_rank_error)
        turn = _with_error(found.torque_rank_correlation, found.torque_rank_error)
        ranks = (
            f"{self.name}: rank correlation of error and uncertainty {force} for force"
        )
        ranks += f" and {turn} for torque" if torque else ""
        if not math.isnan(found.force_place_rank_correlation):
            ranks += f"; between its {found.places} places "
            ranks += f"{found.force_place_rank_correlation:.2f}"
            ranks += f" and {found.torque_place_rank_correlation:.2f}" if torque else ""
        deeper = (
            f"{self.name}: {unknown} frames reach deeper than the saved uncertainty"
        )
        return [line, ranks, deeper] if unknown else [line, ranks]


def _with_error(correlation: float, error: float) -> str:
    """The value with its standard error, if known."""
    return f"{correlation:.2f}" + (f" ± {error:.2f}" if math.isfinite(error) else "")


def recording_lines(
    judged: Evaluation,
    shell: PointShell,
    recorded: Trajectory,
    names: Sequence[str],
    uncertainty: SavedUncertainty | None,
) -> list[RecordingLine]:
    """Report on each recording.

    Args:
        judged: Measured and rendered wrenches of all recordings.
        shell: The probe.
        recorded: All recordings as one.
        names: Names of the files.
        uncertainty: Uncertainty of the field; None if not requested.
    """
    from ttus_opt.fitting.checks.sanity import recording_names
    from ttus_opt.fitting.uncertainty.uncertainty_check import (
        calibration_curve,
        check_uncertainty,
    )
    from ttus_opt.report.hysteresis import hysteresis_share

    parts = recorded.parts
    names = recording_names(names, len(parts))
    out = []
    for name, frames in zip(names, parts, strict=True):
        own, part = recorded.select(frames), judged.over(frames)
        lost = hysteresis_share(own, shell, judged.errors.force_threshold_N)
        found, refused, curve = None, "", None
        if uncertainty is not None:
            try:
                found = check_uncertainty(uncertainty, part, own)
                curve = calibration_curve(uncertainty, part, own)
            except InputError as error:
                refused = str(error)
        line = RecordingLine(name, len(own), lost, found, refused, curve, part.errors)
        out.append(line)
    return out
