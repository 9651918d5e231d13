"""``ttus-opt evaluate``: errors of a field on recorded wrenches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.cli.console import Stages, fitted, tell
from ttus_opt.cli.recording_options import ProbeOptions, RecordingOptions
from ttus_opt.cli.scene_building import scene_of_field, warn_of_mistake
from ttus_opt.cli.sources import probe_for, seen
from ttus_opt.core.errors import InputError, MistakeWarning, located, warn

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ttus_opt.fitting.uncertainty.saved_uncertainty import SavedUncertainty
    from ttus_opt.fitting.uncertainty.uncertainty_check import Calibration
    from ttus_opt.probe.point_shell import PointShell
    from ttus_opt.probe.trajectory import Trajectory
    from ttus_opt.report.extrapolation import Bin
    from ttus_opt.report.metrics import Errors, Evaluation
    from ttus_opt.voxmap.field import PotentialField


@dataclass(frozen=True)
class RecordingLine:
    """One recording.

    Attributes:
        name: Name of the recording.
        frames: Its frames [–].
        hysteresis_share: Work of presses that is not given back; NaN without any.
        uncertainty: Stated uncertainty against errors; None if not requested.
        refused: Why the requested uncertainty is missing; "" otherwise.
        errors: Errors of its frames.
    """

    name: str
    frames: int
    hysteresis_share: float
    uncertainty: Calibration | None = None
    refused: str = ""
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
                f"{self.name}: its presses lose {100 * self.hysteresis_share:z.0f} % "
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
    from ttus_opt.fitting.uncertainty.uncertainty_check import check_uncertainty
    from ttus_opt.report.metrics import hysteresis_share

    parts = recorded.parts
    names = recording_names(names, len(parts))
    out = []
    for name, frames in zip(names, parts, strict=True):
        own, part = recorded.select(frames), judged.over(frames)
        lost = hysteresis_share(own, shell, judged.errors.force_threshold_N)
        found, refused = None, ""
        if uncertainty is not None:
            try:
                found = check_uncertainty(uncertainty, part, own)
            except InputError as error:
                refused = str(error)
        out.append(RecordingLine(name, len(own), lost, found, refused, part.errors))
    return out


def evaluate(
    field: Path,
    probe: ProbeOptions,
    recordings: RecordingOptions,
    picture: Path | None = None,
    uncertainty: bool = False,
    calibration_picture: Path | None = None,
) -> None:
    """Compare rendered with measured force and torque.

    Args:
        picture: Draw measured and rendered force here.
        uncertainty: Compare the errors of every recording with the uncertainty that fit
            --uncertainty saved in the field file.
        calibration_picture: Draw that comparison here; implies --uncertainty.

    Example:
        ttus-opt evaluate --field field.nc --probe ellipsoid:0.030,0.0125,0.018
        --trajectory press_test.csv --json
    """
    from ttus_opt.contact.scene_warnings import cut_off
    from ttus_opt.fitting.uncertainty.saved_uncertainty import read_uncertainty
    from ttus_opt.haptic.field_wrench import over_limits
    from ttus_opt.report import metrics
    from ttus_opt.report.metrics import hysteresis_share
    from ttus_opt.voxmap.field import PotentialField

    pictures = [picture, calibration_picture]
    uncertainty = uncertainty or calibration_picture is not None
    with Stages(2 if pictures == [None, None] else 3) as begin:
        begin("reading field and recordings")
        as_written = recordings.as_written()
        potential = PotentialField.load(field)
        fitted_to = seen(potential.provenance, recordings.trajectory)
        shell = probe_for(potential.provenance, probe, recordings)
        recorded = recordings.read(as_written, shell, potential.voxmap.surface)
        stated = read_uncertainty(field, shell) if uncertainty else None
        begin("rendering")
        with located(", ".join(recordings.names)):
            found = metrics.evaluate(potential, shell, recorded)
        cut = cut_off(potential.voxmap, shell, recorded.rotation, recorded.position)
        warn_of_poses(found.in_grid, found.beyond_inner, cut)
        each = recording_lines(found, shell, recorded, recordings.names, stated)
        far, deep = _extrapolated(potential, shell, recorded, found)
        scene = scene_of_field(potential.voxmap, shell, recorded)
        if scene is not None:
            warn_of_mistake(scene, (as_written, recordings.conventions))
        if pictures != [None, None]:
            begin("drawing")
            _draw(found, each, picture, calibration_picture)
    errors = found.errors
    over = int(over_limits(found.rendered_force, found.rendered_torque).sum())
    lost = hysteresis_share(recorded, shell, errors.force_threshold_N)
    facts = {
        **errors.as_dict(),
        "hysteresis_share": lost,
        "frames_over_limit": over,
        "recordings": fitted_to,
        "by_recording": [one.as_dict() for one in each],
        "by_distance_m": [one.as_dict() for one in far] or None,
        "by_relative_depth": [one.as_dict() for one in deep] or None,
    }
    known = [
        f"{r['name']}: the field was fitted to this recording"
        for r in fitted_to
        if r["seen"]
    ]
    each_own = [line for one in each for line in one.lines]
    if over:
        known.append(
            f"{over} of {errors.frames} frames have more force or torque than a "
            "renderer gives by default; they are judged without its limits"
        )
    told = [*_lines(errors, recorded.has_torque), *_table(each, far, deep)]
    tell(facts, *known, *told, *each_own)


def _extrapolated(
    potential: PotentialField,
    shell: PointShell,
    recorded: Trajectory,
    found: Evaluation,
) -> tuple[list[Bin], list[Bin]]:
    """Errors by distance and by depth; empty where the fitted places are unknown."""
    from ttus_opt.report import extrapolation

    text = potential.provenance.get("contacts")
    if text is None:
        return [], []
    fitted = extrapolation.FittedContacts.from_text(text)
    surface = potential.voxmap.surface
    contacts = extrapolation.Contacts.of(surface, shell, recorded)
    return extrapolation.by_distance_and_depth(fitted, contacts, found)


def _table(each: list[RecordingLine], far: list[Bin], deep: list[Bin]) -> list[str]:
    """Errors of each recording, near and far from the fitted places, light and deep."""
    from ttus_opt.report.tables import errors_by_name

    rows = {one.name: one.errors for one in each} if len(each) > 1 else {}
    for one in far:
        rows[f"{_between(one, 100.0, ' cm')} from fitted places"] = one.errors
    for one in deep:
        rows[f"{_between(one, 1.0, ' of')} the deepest fitted"] = one.errors
    known = {name: errors for name, errors in rows.items() if errors is not None}
    lines = [fitted(errors_by_name(known))] if known else []
    if not far:
        lines.append(
            "near and far: unknown, the field file does not say where it was fitted: "
            "write it with ttus-opt fit"
        )
    return lines


def _between(one: Bin, scale: float, unit: str) -> str:
    """Limits of a bin in words."""
    if math.isinf(one.high):
        return f"over {scale * one.low:g}{unit}"
    return f"{scale * one.low:g} to {scale * one.high:g}{unit}"


def _draw(
    found: Evaluation,
    each: list[RecordingLine],
    forces: Path | None,
    calibration: Path | None,
) -> None:
    """Write the pictures that were asked for: all, or none."""
    from ttus_opt.report import plots

    figures = []
    if calibration is not None:
        told = {one.name: one.uncertainty for one in each}
        curves = {n: c.curve for n, c in told.items() if c is not None and c.curve}
        if not curves:
            raise InputError(f"nothing to draw in {calibration}: {each[0].refused}")
        figures.append((plots.calibration_picture(curves), calibration))
    if forces is not None:
        figures.append((plots.force_over_time({"rendered": found}), forces))
    for figure, path in figures:
        plots.save_picture(figure, path)


def _lines(errors: Errors, has_torque: bool) -> list[str]:
    """Errors of force and torque over all recordings."""
    from ttus_opt.report.tables import number

    lines = [
        f"force   {errors.force_magnitude_error_N:.3f} N mean, "
        f"{errors.force_magnitude_rmse_N:.3f} N rmse, "
        f"{number(errors.force_angle_error_deg, '.1f')}° over "
        f"{errors.frames_in_contact} of {errors.frames} frames in contact"
    ]
    if not math.isnan(errors.share_told_apart):
        lines.append(
            f"felt    {100 * errors.share_told_apart:.1f} % of the frames in contact "
            "differ noticeably from the measured ones (by more than 7 % and 0.36 N, "
            "or 18°)"
        )
    if not has_torque:
        return [*lines, "torque  not measured"]
    torque = (
        f"torque  {1e3 * errors.torque_magnitude_error_Nm:.1f} mN m mean, "
        f"{1e3 * errors.torque_magnitude_rmse_Nm:.1f} mN m rmse, "
        f"{number(errors.torque_angle_error_deg, '.1f')}° over "
        f"{errors.frames_with_torque} frames with a torque"
    )
    return [*lines, torque]


def warn_of_poses(
    in_grid: NDArray[np.bool_], beyond: NDArray[np.int64], cut: NDArray[np.bool_]
) -> None:
    """Say when poses lie off the field's grid, or reach beyond it."""
    off = int(in_grid.size - in_grid.sum())
    if off:
        warn(
            f"{off} of {in_grid.size} poses lie outside the field's grid and give "
            "zero force: check the trajectory's frame and unit",
            kind=MistakeWarning,
        )
    if cut.any():
        warn(
            f"{cut.sum()} of {cut.size} poses touch the patient beyond the field's "
            "sector or ends too, where nothing pushes back: fit with a wider --sector"
        )
    deep = int((beyond > 0).sum())
    if deep:
        warn(
            f"{deep} of {beyond.size} poses reach below the field's innermost layer, "
            "where that layer's values continue: fit with a smaller --r-inner"
        )
