"""The report of an experiment: options, tables, figures and aims."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ttus_opt.experiment import paper_averages as paper
from ttus_opt.experiment import tables
from ttus_opt.experiment.boundary import UNSEEN
from ttus_opt.experiment.fits import (
    AIM_ANGLE,
    AIM_TORQUE,
    AIM_TORQUE_ANGLE,
    PREFIX,
    PatientFits,
    Row,
    meets,
)
from ttus_opt.experiment.result import FIGURES, ExperimentResult, PatientResult
from ttus_opt.experiment.settings import LAPLACE, PAPER_WITH, PAPER_WITHOUT
from ttus_opt.experiment.tables import title
from ttus_opt.phantom.recording import FORCE_NOISE, TORQUE_NOISE
from ttus_opt.probe.tracker_noise import TrackerNoise
from ttus_opt.report import plots
from ttus_opt.report.calibration_curve import CalibrationCurve
from ttus_opt.report.document import (
    Block,
    Heading,
    Items,
    Picture,
    Table,
    Text,
    write_report,
)
from ttus_opt.report.plots.canvas import AFTER, BEFORE, look, new_figure
from ttus_opt.report.tables import ANGLE, FORCE

TITLE = "The paper's experiment on three phantom patients"


def write_reports(folder: Path, result: ExperimentResult) -> None:
    """Draw the figures and write ``report.md`` and ``report.html`` into a folder.

    Raises:
        FileError: The folder cannot be written to.
    """
    best = best_setting(result)
    blocks = [*summary(result), Heading("Figures"), *draw(result, best)]
    write_report(folder, blocks)


def best_setting(result: ExperimentResult) -> str:
    """The compared formulation whose forces are hardest to distinguish from the truth.

    By the mean fraction of distinguishable frames on new trajectories, true wrenches.
    The choice is made in hindsight, and the report says so.
    """
    rows = tables.select(result.rows, seen=False, against="true")
    apart = {PAPER_WITHOUT.name, PAPER_WITH.name, LAPLACE.name}
    names = [
        name
        for name in dict.fromkeys(row.setting for row in rows)
        if name not in apart and not name.startswith(PREFIX)
    ]

    def told_apart(name: str) -> float:
        scored = tables.select(rows, setting=name)
        return float(np.mean([row.score.share_told_apart for row in scored]))

    return min(names, key=told_apart)


def summary(result: ExperimentResult) -> list[Block]:
    """Everything but the figures."""
    best = best_setting(result)
    blocks: list[Block] = [Heading(TITLE, 1), *_what_was_done(result)]
    blocks += [tables.recordings_table(result)]
    blocks += [Heading("Counterparts of the paper's tables I to IV"), _ABOUT_PAPER]
    for name, table in tables.paper_tables(result, best).items():
        blocks += [Heading(name, 3), table]
    blocks += [Heading("Torque without → with its term"), _ABOUT_TORQUE]
    blocks += [tables.torque_table(result)]
    blocks += [Heading("How much the boundary value matters"), _ABOUT_BOUNDARY]
    blocks += [tables.boundary_table(result)]
    blocks += [Heading("Formulations on new trajectories"), _ABOUT_AIMS]
    for against, told in (
        ("true", "Against true wrenches at true poses, the error of the model alone:"),
        (
            "measured",
            "Against measured wrenches at reported poses, as a laboratory would "
            "judge. The phantom itself, rendered at the reported poses, has the last "
            "line: what noise alone makes, and nothing is better.",
        ),
    ):
        blocks += [Text(told), tables.comparison_table(result, against)]
    for told, column in (
        ("Which wins where, mean magnitude error against the truth [N]:", FORCE),
        ("The same for the mean angle [°]:", ANGLE),
    ):
        blocks += [Text(told), tables.winners_table(result, column)]
    beside, weights = tables.rivals_table(result, best), tables.weights_table(result)
    for heading, about, table in (
        ("Other ways, same data", _about_rivals(result), beside),
        ("Weights chosen from the recordings", _ABOUT_WEIGHTS, weights),
        ("How sure the model is", _UNCERTAINTY, tables.uncertainty_table(result)),
    ):
        blocks += [Heading(heading), about, table] if table else []
    return [*blocks, *_aims(result, best)]


def _what_was_done(result: ExperimentResult) -> list[Block]:
    plan = result.plan
    shape = " × ".join(map(str, plan.shape))
    patients = [
        f"**{p.patient.name}**: {p.patient.build}; Coulomb drag {p.patient.drag:g}, "
        f"damping {p.patient.damping:g} s/m, seed {p.patient.seed}"
        for p in result.patients
    ]
    return [
        Text(
            "Three phantoms (linear elasticity by finite elements, unilateral contact "
            "with a rigid ellipsoid probe; they know nothing of potential fields) are "
            "pressed and swept, each twice for 20 s at 20 Hz: once to fit, once by "
            "another path. One field is fitted to both recordings of the first kind. "
            "Made by `ttus-opt experiment`."
        ),
        Items(
            [
                *patients,
                f"Noise: force {FORCE_NOISE:g} N, torque {1e3 * TORQUE_NOISE:g} mN m "
                f"per axis and frame; poses {1e3 * TrackerNoise.position:g} mm and "
                f"{np.degrees(TrackerNoise.rotation):.2g}° per axis, alike over "
                f"{TrackerNoise.correlation:g} s (a tracker's drift, in fit and test "
                "alike)",
                "Drag: Coulomb; damping: normal force times (1 + damping × speed "
                "into the body)",
                f"Grid {shape}, trilinear sampling, λ_f = λ_τ = {plan.weight:g} unless "
                "a formulation chooses its own; the paper's columns: voxel-mean "
                "sampling on a staircase, p_in = p_out = 1, λ_f = λ_τ = 1e-4",
                f"Finite elements at {plan.resolution:g} times the bundled example's "
                "spacing; the surface is the true skin, 2° by 5 mm",
            ]
        ),
    ]


_ABOUT_PAPER = Text(
    "Mean errors against the measured wrenches, without (Laplace only) and with "
    "measured forces. The paper's boundary value is its own choice for its "
    "patients, who were not these: the third column has the one number that suits "
    "these measurements best. Of the paper's averages over three people, "
    f"{100 * paper.GAIN_FORCE:.0f} %, {paper.GAIN_ANGLE_DEG:g}° and "
    f"{100 * paper.GAIN_ANGLE:.0f} % follow from the cells of its tables I and II "
    "(which are not part of this package), "
    f"{paper.PRINTED_GAIN_FORCE_N:g} N does not: they give {paper.GAIN_FORCE_N:g} N. "
    "On new trajectories its mean errors fall by "
    f"{100 * paper.fall(*paper.NEW_FORCE):.0f} % and "
    f"{100 * paper.fall(*paper.NEW_ANGLE):.0f} %."
)


_ABOUT_TORQUE = Text(
    "Eq. 10 fitted to forces alone → to forces and torques, which the paper leaves "
    "to future work. Means of press and sweep."
)


_ABOUT_BOUNDARY = Text(
    "Mean magnitude error [N] on new trajectories while the value of the inner "
    "layer runs over a decade: before (Laplace alone) and after fitting eq. 10."
)


def _about_rivals(result: ExperimentResult) -> Text:
    whose = [each.patient.name for each in result.patients if each.rivals]
    return Text(
        f"Mean errors on the new trajectories of {', '.join(whose)} against true "
        "wrenches. Processor time of a "
        "frame, in Python where the comparator is: compare within the table only. "
        "Ripple on a slow straight slide."
    )


_ABOUT_AIMS = Text(
    "Means over the new trajectories of all patients. *Told apart*: share of "
    "frames whose force is off by more than 7 % and 0.36 N, or by 18°. Aims: "
    "median magnitude error ≤ 7 % or 0.36 N, mean angle ≤ "
    f"{AIM_ANGLE:g}°, torque magnitude ≤ {100 * AIM_TORQUE:g} %, torque angle ≤ "
    f"{AIM_TORQUE_ANGLE:g}°; *each aim met*: on how many recordings, in this order."
)


_ABOUT_WEIGHTS = Text(
    "As `ttus-opt fit` chooses them when no weight is given: of a depth map by "
    "marginal likelihood, of others by how well places left out are predicted; the "
    "formulation's own where the recordings bear no choice. Both recordings that are "
    "fitted are used, those of new trajectories are not."
)


_UNCERTAINTY = Text(
    "Median standard deviation that the fit states for rendered force and torque on "
    "new trajectories, and the share of measured components within the 95 % interval "
    "of this and the estimated noise together (90 to 98 % are asked). *Rank*: rank "
    "correlation of error and stated standard deviation over frames, and over the "
    "means of places. The figure has all other intervals."
)


def _aims(result: ExperimentResult, best: str) -> list[Block]:
    """The aims that each setting misses, and by how much the best one does."""
    lines = []
    for against in ("true", "measured"):
        rows = tables.select(result.rows, seen=False, against=against, setting=best)
        for row in rows:
            lines.append([f"{row.patient}, {row.recording}", against, *_cells(row)])
    header = ["", "against", "force", "worst 5 %", "angle", "worst 5 %", "torque"]
    return [
        Heading("The aims, recording by recording"),
        Text(
            "Which aims each formulation misses on new trajectories, true wrenches: "
            "all four, those named, or none (✓)."
        ),
        tables.aims_table(result),
        Text(
            f"By how much {tables.title(best)} does, the formulation with the fewest "
            "frames told apart (chosen after the fact); ✓ reached, ✗ not."
        ),
        Table([*header, "torque angle", "told apart"], lines),
    ]


def _cells(row: Row) -> list[str]:
    score, met = (
        row.score,
        {n: "✓" if ok else "✗" for n, ok in meets(row.score).items()},
    )
    force = f"{score.force_median_N:.2f} N, {100 * score.force_median_share:.1f} %"
    return [
        f"{force} {met['force']}",
        f"{score.force_worst_N:.2f} N",
        f"{score.force_angle_error_deg:.1f}° {met['angle']}",
        f"{score.angle_worst_deg:.1f}°",
        f"{100 * score.torque_share:.1f} % {met['torque']}",
        f"{score.torque_angle_error_deg:.1f}° {met['torque angle']}",
        f"{100 * score.share_told_apart:.0f} %",
    ]


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
