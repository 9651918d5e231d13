"""The report's tables: the paper's counterparts, torque, boundary, formulations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ttus_opt.experiment import paper_averages as paper
from ttus_opt.experiment.fits import PREFIX, Row, meets
from ttus_opt.experiment.patients import PROBE_SPEC
from ttus_opt.experiment.result import ITSELF, ExperimentResult
from ttus_opt.experiment.settings import (
    BY_DEFAULT,
    CHOSEN,
    LAPLACE,
    PAPER_WITH,
    PAPER_WITHOUT,
    REFINED,
)
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.report.document import Table
from ttus_opt.report.metrics import FORCE_THRESHOLD, Errors, hysteresis_share
from ttus_opt.report.tables import ANGLE, FORCE, Column, number

#: Names of settings as tables print them
TITLES = {
    PAPER_WITHOUT.name: "Laplace, p_in = 1",
    PAPER_WITH.name: "eq. 10, the paper's weights",
    LAPLACE.name: "Laplace, p_in fitted",
    "eq10": "eq. 10",
    "eq10_force_only": "eq. 10, forces only",
    BY_DEFAULT.name: "default",
    REFINED.name: "default, poses refined",
    ITSELF: "(the phantom itself)",
}

_TORQUE = Column("torque [%]", lambda e: 100 * e.torque_share, ".0f")
_TORQUE_ANGLE = Column("torque angle [°]", lambda e: e.torque_angle_error_deg, ".0f")
_APART = Column("told apart [%]", lambda e: 100 * e.share_told_apart, ".0f")


def title(setting: str) -> str:
    """A setting's name as a table prints it."""
    plain = setting.removesuffix(CHOSEN)
    name = TITLES.get(plain, plain)
    return name if plain == setting else f"{name}, weights chosen"


def select(rows: Iterable[Row], **wanted: object) -> list[Row]:
    """Rows with the given attributes."""
    return [r for r in rows if all(getattr(r, k) == v for k, v in wanted.items())]


def _by_place(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Rows of each patient and recording, by both names."""
    places: dict[str, list[Row]] = {}
    for row in rows:
        name = f"{row.patient}, {row.recording.split('_')[0]}"
        places.setdefault(name, []).append(row)
    return places


def _errors(rows: Iterable[Row], **wanted: object) -> list[Errors]:
    """Errors of rows with the given attributes."""
    return [row.score for row in select(rows, **wanted)]


def paper_tables(result: ExperimentResult, best: str) -> dict[str, Table]:
    """Counterparts of tables I to IV, by what they show.

    Args:
        result: Result of the experiment.
        best: Setting of the last column.
    """
    columns = list(
        dict.fromkeys((PAPER_WITHOUT.name, PAPER_WITH.name, LAPLACE.name, "eq10", best))
    )
    tables = {}
    for seen, motion in ((True, "same trajectory"), (False, "new trajectory")):
        rows = select(result.rows, seen=seen, against="measured")
        for name, read in (("Magnitude error [N]", FORCE), ("Angle [°]", ANGLE)):
            lines = [
                [place, *(read.cell(*_errors(there, setting=c)) for c in columns)]
                for place, there in _by_place(rows).items()
            ]
            means = [read.cell(*_errors(rows, setting=c)) for c in columns]
            lines.append(["**mean**", *(f"**{cell}**" for cell in means)])
            lines.append([*_paper_row(name, seen), *[""] * (len(columns) - 2)])
            tables[f"{name}, {motion}"] = Table(["", *map(title, columns)], lines)
    return tables


def _paper_row(name: str, seen: bool) -> list[str]:
    """The paper's averages over three people, where they are known."""
    if not seen:
        without, with_ = paper.NEW_FORCE if name.startswith("M") else paper.NEW_ANGLE
        return ["the paper, three people", f"{without:g}", f"{with_:g}"]
    if name.startswith("M"):
        gain = f"−{100 * paper.GAIN_FORCE:.0f} %, −{paper.GAIN_FORCE_N:g} N"
    else:
        gain = f"−{100 * paper.GAIN_ANGLE:.0f} %, −{paper.GAIN_ANGLE_DEG:g}°"
    return ["the paper, three people", "", gain]


def recordings_table(result: ExperimentResult) -> Table:
    """The recordings: contact, force, torque, and hysteresis."""
    shell = PointShell.from_spec(PROBE_SPEC)
    lines = []
    for each in result.patients:
        for name, given in each.examination.measured.items():
            assert given.force is not None
            assert given.torque is not None
            size = np.linalg.norm(given.force, axis=1)
            touching = size > FORCE_THRESHOLD
            torque = 1e3 * np.linalg.norm(given.torque, axis=1)[touching]
            lost = 100 * hysteresis_share(given, shell, FORCE_THRESHOLD)
            cells = [
                f"{touching.sum()}/{len(given)}",
                f"{np.median(size[touching]):.1f}",
            ]
            cells += [f"{size.max():.1f}", f"{np.median(torque):.0f}"]
            lines.append([f"{each.patient.name}, {name}", *cells, number(lost, ".0f")])
    header = ["", "in contact", "median [N]", "largest [N]", "median torque [mN m]"]
    return Table([*header, "work of presses not given back [%]"], lines)


def torque_table(result: ExperimentResult) -> Table:
    """Torque and force errors without and with the torque term."""
    pair = ("eq10_force_only", "eq10")
    columns = (
        Column("torque [mN m]", lambda e: 1e3 * e.torque_magnitude_error_Nm, ".1f"),
        _TORQUE,
        _TORQUE_ANGLE._replace(form=".1f"),
        FORCE,
    )
    lines = []
    for seen, motion in ((True, "same"), (False, "new")):
        rows = select(result.rows, seen=seen, against="measured")
        for patient in dict.fromkeys(r.patient for r in rows):
            both = [_errors(rows, patient=patient, setting=name) for name in pair]
            cells = [" → ".join(c.cell(*errors) for errors in both) for c in columns]
            lines.append([f"{patient}, {motion}", *cells])
    return Table(["", *(column.title for column in columns)], lines)


def uncertainty_table(result: ExperimentResult) -> Table:
    """Stated uncertainty against errors on new trajectories; empty without any."""
    lines = []
    for each in result.patients:
        for stated in each.uncertainties:
            name = f"{each.patient.name}, {title(stated.setting)}"
            if stated.refused:
                lines.append([f"{name}: {stated.refused}", *[""] * 6])
            for recording, figures in stated.figures.items():
                force, error = figures.force_rank_correlation, figures.force_rank_error
                lines.append(
                    [
                        f"{name}, {recording.split('_')[0]}",
                        number(figures.force_std_N, ".2f"),
                        number(100.0 * figures.force_coverage, ".1f"),
                        number(1e3 * figures.torque_std_Nm, ".1f"),
                        number(100.0 * figures.torque_coverage, ".1f"),
                        f"{number(force, '.2f')} ± {number(error, '.2f')}",
                        number(figures.force_place_rank_correlation, ".2f"),
                    ]
                )
    header = ["", "force [N]", "covered [%]", "torque [mN m]", "covered [%]"]
    return Table([*header, "rank", "between places"], lines)


def boundary_table(result: ExperimentResult) -> Table:
    """Error over a decade of boundary values, and its spread, per patient."""
    factors = list(dict.fromkeys(row.factor for row in result.boundary))
    lines = []
    for patient in dict.fromkeys(row.patient for row in result.boundary):
        of_patient = [row for row in result.boundary if row.patient == patient]
        for name, values in (
            ("before", [row.before_N for row in of_patient]),
            ("after", [row.after_N for row in of_patient]),
        ):
            cells = [number(value) for value in values]
            lines.append([f"{patient}, {name}", *cells, f"**{np.ptp(values):.2f}**"])
    header = ["p_in / fitted p_in", *(f"{f:.2f}" for f in factors), "spread"]
    return Table(header, lines)


def comparison_table(result: ExperimentResult, against: str) -> Table:
    """Every setting over all new trajectories, and how many aims it meets."""
    columns = (
        Column("median [N]", lambda e: e.force_median_N),
        Column("median [%]", lambda e: 100 * e.force_median_share, ".1f"),
        Column("worst 5 % [N]", lambda e: e.force_worst_N),
        ANGLE,
        Column("worst 5 % [°]", lambda e: e.angle_worst_deg, ".0f"),
        *(_TORQUE, _TORQUE_ANGLE, _APART),
    )
    rows = _unseen(result, against)
    lines = []
    for name in dict.fromkeys(r.setting for r in rows):
        scored = select(rows, setting=name)
        cells = [column.cell(*_errors(scored)) for column in columns]
        met = [all(meets(row.score).values()) for row in scored]
        parts = _parts_met(scored)
        lines.append([title(name), *cells, parts, f"{sum(met)}/{len(met)}"])
    header = [column.title for column in columns]
    return Table(["", *header, "each aim met", "all met"], lines)


def _unseen(result: ExperimentResult, against: str) -> list[Row]:
    """Rows of new motion, those of comparators left out."""
    rows = select(result.rows, seen=False, against=against)
    return [row for row in rows if not row.setting.startswith(PREFIX)]


def _parts_met(rows: Sequence[Row]) -> str:
    """How often each aim is met: force, angle, torque, torque angle."""
    met = [meets(row.score) for row in rows]
    return ", ".join(str(sum(each[name] for each in met)) for name in met[0])


def winners_table(result: ExperimentResult, column: Column) -> Table:
    """Errors of every setting per unseen recording, the least in bold."""
    rows = _unseen(result, "true")
    names = list(dict.fromkeys(r.setting for r in rows))
    lines = []
    for place, there in _by_place(rows).items():
        values = [column.mean(_errors(there, setting=name)) for name in names]
        least = np.nanmin(values)
        cells = [number(value, column.form) for value in values]
        cells = [
            f"**{cell}**" if value == least else cell
            for cell, value in zip(cells, values, strict=True)
        ]
        lines.append([place, *cells])
    return Table(["", *map(title, names)], lines)


def aims_table(result: ExperimentResult) -> Table:
    """The aims that every setting misses on every unseen recording."""
    rows = _unseen(result, "true")
    places = _by_place(rows)
    lines = []
    for name in dict.fromkeys(r.setting for r in rows):
        own = (select(there, setting=name) for there in places.values())
        cells = (_missed(there[0]) if there else "–" for there in own)
        lines.append([title(name), *cells])
    return Table(["", *places], lines)


def _missed(row: Row) -> str:
    met = meets(row.score)
    missed = [name for name, reached in met.items() if not reached]
    return "all" if len(missed) == len(met) else ", ".join(missed) or "✓"


def weights_table(result: ExperimentResult) -> Table:
    """Weights chosen from the recordings, or why none were."""
    lines = []
    for each in result.patients:
        for name, fit in each.fits.items():
            chosen = fit.facts.get("weights_chosen")
            if chosen is None:
                continue
            weights = ", ".join(f"{k} {w:.2g}" for k, w in chosen["weights"].items())
            why = chosen["reason"] or chosen["by"]
            row = [f"{each.patient.name}, {title(name)}", fit.facts["formulation"]]
            lines.append([*row, weights or "–", why])
    header = ["", "formulation", "weights", "chosen by, or why not"]
    return Table(header, lines)


def rivals_table(result: ExperimentResult, best: str) -> Table:
    """Comparators, if any, and the best field: errors, time of a frame, ripple."""
    examined = [each for each in result.patients if each.rivals]
    names = list(dict.fromkeys(r.name for each in examined for r in each.rivals))
    if not names:
        return Table([], [])
    whose = {each.patient.name for each in examined}
    rows = select(result.rows, seen=False, against="true")
    rows = [row for row in rows if row.patient in whose]
    columns = (FORCE, ANGLE, _TORQUE, _TORQUE_ANGLE, _APART)

    def means(setting: str) -> list[str]:
        errors = _errors(rows, setting=setting)
        return [column.cell(*errors) for column in columns]

    lines = [[f"({title(best)})", *means(best), "–", "–"]]
    for name in names:
        facts = [r.facts for each in examined for r in each.rivals if r.name == name]
        failures = [f["failure"] for f in facts if "failure" in f]
        if failures:
            lines.append([name, f"not fitted: {failures[0]}", *[""] * 6])
            continue
        frame, ripple = (
            float(np.median([f[key] for f in facts]))
            for key in ("ms_per_frame", "ripple")
        )
        times = number(frame, ".2g"), number(100 * ripple, ".2g")
        lines.append([name, *means(PREFIX + name), *times])
    header = ["", *(column.title for column in columns)]
    return Table([*header, "ms per frame", "ripple [%]"], lines)
