"""Figures of the report: trajectories and slices without and with measured forces."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from ttus_opt.experiment.boundary import UNSEEN
from ttus_opt.experiment.fits import PatientFits
from ttus_opt.experiment.result import FIGURES, ExperimentResult, PatientResult
from ttus_opt.experiment.settings import LAPLACE, PAPER_WITHOUT
from ttus_opt.experiment.tables import title
from ttus_opt.report import plots
from ttus_opt.report.calibration_curve import CalibrationCurve
from ttus_opt.report.document import Picture
from ttus_opt.report.plots.canvas import AFTER, BEFORE, look, new_figure


def draw(result: ExperimentResult, best: str) -> list[Picture]:
    """All pictures, in the order of the report.

    Args:
        result: Result of the experiment.
        best: The setting shown as "with measured forces".
    """
    pictures = []
    for each in result.patients:
        pictures += _of_patient(each, best)
    caption = (
        "Error on new trajectories over a decade of boundary values, without "
        "(dashed) and with measured forces"
    )
    pictures.append(_picture("boundary", boundary_picture(result), caption))
    curves, whose = _curves(result)
    if curves:
        caption = (
            f"Stated uncertainty ({whose}) on new trajectories: share of measured "
            "force components within the stated intervals, and error over the stated "
            "standard deviation; both should follow the grey line, and the bar is what "
            "is asked of the 95 % interval"
        )
        figure = plots.calibration_picture(curves)
        pictures.append(_picture("calibration", figure, caption))
    return pictures


def _curves(result: ExperimentResult) -> tuple[dict[str, CalibrationCurve], str]:
    """Curves of each patient's last setting that has some, and the settings' names."""
    curves, names = {}, []
    for each in result.patients:
        drawn = [stated for stated in each.uncertainties if stated.curves]
        for recording, curve in (drawn[-1].curves if drawn else {}).items():
            curves[f"{each.patient.name}, {recording.split('_')[0]}"] = curve
            names.append(title(drawn[-1].setting))
    return curves, " or ".join(dict.fromkeys(names))


def boundary_picture(result: ExperimentResult) -> Figure:
    """Error over the boundary value, before and after, a panel per patient."""
    names = [each.patient.name for each in result.patients]
    with look():
        figure = new_figure(7.2, 2.9)
        axes = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
        for panel, name in zip(axes, names, strict=True):
            points = [row for row in result.boundary if row.patient == name]
            factors = [row.factor for row in points]
            before, after = [r.before_N for r in points], [r.after_N for r in points]
            for values, style, label in (
                (before, {"color": BEFORE, "linestyle": "--"}, "without forces"),
                (after, {"color": AFTER}, "with measured forces"),
            ):
                panel.plot(factors, values, marker="o", label=label, **style)
            panel.set_xscale("log")
            panel.set_xticks(factors[::2], [f"{f:.2g}" for f in factors[::2]])
            panel.minorticks_off()
            panel.set_xlabel("p_in over its fitted value [–]")
            panel.set_title(name)
            panel.set_ylim(bottom=0.0)
        axes[0].set_ylabel("magnitude error [N]")
        drawn = axes[0].get_legend_handles_labels()
        figure.legend(*drawn, loc="outside lower center", ncols=2)
    return figure


def _of_patient(each: PatientResult, best: str) -> list[Picture]:
    name = each.patient.name
    names = (PAPER_WITHOUT.name, best, LAPLACE.name, "eq10")
    fields = [each.fits[setting].field for setting in names]
    there = [one for one in fields if one is not None]
    if len(there) < len(fields):
        return []  # the tables say which fit failed
    without, fitted, prior, eq10 = there
    judge = PatientFits(each.examination, Path(), (0, 0, 0), "")
    pictures = []
    for recording in UNSEEN:
        pair = {
            "without": judge.evaluation(without, recording, "measured"),
            "with measured forces": judge.evaluation(fitted, recording, "measured"),
        }
        kind = recording.split("_")[0]
        figure = plots.force_over_time(pair, f"{name}: {kind}, new trajectory")
        caption = (
            f"{name}, {kind}, a trajectory that was not fitted: measured force, and "
            "rendered without (Laplace alone, p_in = 1) and with measured forces "
            f"({title(best)})"
        )
        pictures.append(_picture(f"{name}-{kind}", figure, caption))
    caption = (
        f"{name}: potential in a slice, Laplace alone with its boundary value fitted, "
        "with measured wrenches (eq. 10), and the difference"
    )
    figure = plots.potential_slices(prior, eq10)
    return [*pictures, _picture(f"{name}-slice", figure, caption)]


def _picture(name: str, figure: Figure, caption: str) -> Picture:
    return Picture(f"{FIGURES}/{name}.png", caption, figure)
