"""Coverage of the stated uncertainty over repeated draws of noise.

    ttus-opt experiment --torso ct_skin_mm.ply -o results
    python benchmarks/uncertainty_coverage.py results --keep draws.jsonl

An interval of 95 % is calibrated if it covers 95 % over repetitions, not in each of
them. Every draw gives all four recordings of a patient, fitted and unseen, new noise of
poses and wrenches; a formulation is fitted, and its uncertainty compared with the
measured wrenches of the unseen recordings. Errors against true wrenches at true poses
tell how much of it is not noise.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import ttus_opt as tt
from ttus_opt.core.arrays import Array
from ttus_opt.core.saved_results import append_line, read_lines
from ttus_opt.experiment.boundary import UNSEEN
from ttus_opt.experiment.fits import PatientFits
from ttus_opt.experiment.patients import (
    RECORDINGS,
    Examination,
    Patient,
    examine,
    patients,
)
from ttus_opt.experiment.settings import AUTO, GIVEN, Setting, chosen, compared
from ttus_opt.fitting.uncertainty.uncertainty_check import (
    NORMAL,
    StatesUncertainty,
    check_uncertainty,
)
from ttus_opt.phantom.recording import add_noise, add_pose_noise

#: First word of all seeds, away from those of the patients and of other benchmarks
SEED = 700_000

COLUMNS = (
    "patient, motion",
    "force covered",
    "torque covered",
    "force: stated, error [N]",
    "torque [mN m]",
    "ranks: force, torque",
    "true force",
    "true torque",
)

#: Figures that are pooled
POOLED = ("force_coverage", "torque_coverage", "force_alone", "torque_alone")


@dataclass(frozen=True)
class Row:
    """Uncertainty and errors on one unseen recording of one draw.

    Attributes:
        patient: Name.
        recording: Name.
        draw: Its number.
        force_coverage: Share of measured force components within the interval of the
            field's part and noise together [–].
        torque_coverage: The same for torque.
        force_std: Median stated standard deviation of the field's force, √ trace [N].
        torque_std: The same for torque [N·m].
        force_error: Median length of the error against the true force [N].
        torque_error: The same for torque [N·m].
        force_ranks: Rank correlation of uncertainty and error in measured frames [–].
        torque_ranks: The same for torque.
        force_alone: Share of true force components, at true poses, within the interval
            that is stated for them [–].
        torque_alone: The same for torque.
    """

    patient: str
    recording: str
    draw: int
    force_coverage: float
    torque_coverage: float
    force_std: float
    torque_std: float
    force_error: float
    torque_error: float
    force_ranks: float
    torque_ranks: float
    force_alone: float
    torque_alone: float


def redrawn(examination: Examination, draw: int) -> Examination:
    """The examination with new noise of all poses and wrenches.

    Args:
        examination: Whose true recordings are kept.
        draw: Number of the draw.
    """
    measured = {}
    for name, true in examination.true.items():
        seed = [SEED, examination.patient.seed, draw, RECORDINGS[name]]
        rng = np.random.default_rng(seed)
        measured[name] = add_noise(add_pose_noise(true, rng), rng)
    return replace(examination, measured=measured)


def judged(fits: PatientFits, setting: Setting, draw: int) -> Iterator[Row]:
    """Fit a draw, state its uncertainty, and check it on the unseen recordings."""
    solution, scene, _ = fits.solved(setting)
    stated = tt.uncertainty(solution, scene)
    for name in UNSEEN:
        measured = fits.examination.measured[name]
        errors = fits.evaluation(solution.field, name, "measured")
        found = check_uncertainty(stated, errors, measured)
        true = fits.evaluation(solution.field, name, "true")
        alone = against_truth(stated, true, fits.examination.true[name])
        yield Row(
            *(fits.examination.patient.name, name, draw),
            *(found.force_coverage, found.torque_coverage),
            *(found.force_std_N, found.torque_std_Nm),
            *(alone["force_error"], alone["torque_error"]),
            *(found.force_rank_correlation, found.torque_rank_correlation),
            *(alone["force_alone"], alone["torque_alone"]),
        )


def against_truth(
    stated: StatesUncertainty, errors: tt.Evaluation, true: tt.Trajectory
) -> dict[str, float]:
    """Errors against true wrenches, and their share within the field's interval."""
    along = stated.std(true)
    touching = along.known & (along.force_size > 0.0)
    out = {}
    for part, std, error in (
        ("force", along.force, errors.rendered_force - errors.measured_force),
        ("torque", along.torque, errors.rendered_torque - errors.measured_torque),
    ):
        off = error[touching]
        out[f"{part}_error"] = float(np.median(np.linalg.norm(off, axis=1)))
        out[f"{part}_alone"] = float((np.abs(off) <= NORMAL * std[touching]).mean())
    return out


def pooled(rows: Sequence[Row], figure: str) -> tuple[float, float]:
    """Mean of a figure over patients and recordings, and its standard error.

    Draws are independent, the recordings of a draw are not: the error is that of the
    patients' means over draws. NaN with fewer than two draws.
    """
    means, squares = [], []
    for patient in sorted({row.patient for row in rows}):
        own = [row for row in rows if row.patient == patient]
        draws = sorted({row.draw for row in own})
        each = [
            np.mean([getattr(row, figure) for row in own if row.draw == draw])
            for draw in draws
        ]
        means.append(np.mean(each))
        single = len(each) < 2
        squares.append(np.nan if single else np.var(each, ddof=1) / len(each))
    return float(np.mean(means)), float(np.sqrt(np.sum(squares)) / len(means))


def line(name: str, rows: Sequence[Row]) -> str:
    """A row of the table: means over draws, of coverage also lowest and highest."""

    def column(figure: str) -> Array:
        return np.array([getattr(row, figure) for row in rows])

    def spread(figure: str) -> str:
        low, mean, high = (100 * f(column(figure)) for f in (np.min, np.mean, np.max))
        return "–" if np.isnan(mean) else f"{mean:.0f} ({low:.0f}–{high:.0f}) %"

    cells = [name, spread("force_coverage"), spread("torque_coverage")]
    for part, unit, digits in (("force", 1.0, 2), ("torque", 1e3, 1)):
        stated, error = (
            f"{unit * column(f'{part}_{what}').mean():.{digits}f}"
            for what in ("std", "error")
        )
        cells.append(f"{stated}, {error}")
    ranks = (column(f"{part}_ranks").mean() for part in ("force", "torque"))
    cells.append(", ".join(f"{each:.2f}" for each in ranks))
    cells += [spread("force_alone"), spread("torque_alone")]
    # depth maps state no uncertainty for torque
    known = (cell.replace("nan", "–") for cell in cells)
    return f"| {' | '.join(known)} |"


def table(rows: Sequence[Row]) -> str:
    """The table over all rows, and the pooled coverage below it."""
    lines = [f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|"]
    for key in dict.fromkeys((row.patient, row.recording) for row in rows):
        own = [row for row in rows if (row.patient, row.recording) == key]
        lines.append(line(f"{key[0]}, {key[1].removesuffix('_test')}", own))
    lines.append(line("all", rows))
    for figure in POOLED:
        mean, error = (100 * value for value in pooled(rows, figure))
        if not np.isnan(mean):
            known = "" if np.isnan(error) else f" ± {error:.1f}"
            lines.append(f"{figure}: {mean:.1f}{known} %")
    return "\n".join(lines)


@dataclass(frozen=True)
class Repetition:
    """What every draw is fitted with.

    Attributes:
        results: Folder of the experiment.
        setting: Formulation, sampling and weights.
        shape: Voxels in r, θ and z [–].
        resolution: Of the finite elements.
        keep: File of finished draws, JSON lines; None for no file.
    """

    results: Path
    setting: Setting
    shape: tuple[int, int, int]
    resolution: float
    keep: Path | None

    def rows(self, patient: Patient, draws: Iterable[int]) -> Iterator[Row]:
        """Rows of a patient's draws, computed or from the file of finished ones."""
        folder = self.results / patient.name
        examination = examine(patient, folder, self.resolution)
        for draw in draws:
            key = self._key(patient, draw)
            rows = self._kept(key)
            if not rows:
                fits = PatientFits(
                    redrawn(examination, draw), folder, self.shape, digest=""
                )
                rows = list(judged(fits, self.setting, draw))
                self._save(key, rows)
            yield from rows

    def _key(self, patient: Patient, draw: int) -> dict[str, Any]:
        digest = patient.digest(self.resolution)
        fitted = {"setting": self.setting.as_dict(), "shape": list(self.shape)}
        return {"digest": digest, "draw": draw, **fitted}

    def _kept(self, key: dict[str, Any]) -> list[Row]:
        found = [] if self.keep is None else read_lines(self.keep)
        return [
            Row(**row) for each in found if each["key"] == key for row in each["rows"]
        ]

    def _save(self, key: dict[str, Any], rows: Sequence[Row]) -> None:
        if self.keep is not None:
            content = {"key": key, "rows": [asdict(row) for row in rows]}
            append_line(self.keep, content)


def setting_of(formulation: str, sampling: str, weights: str) -> Setting:
    """The setting of a formulation, by weights of 1 or those that it chooses."""
    if weights == GIVEN:
        (setting,) = compared((formulation,), 1.0)
    else:
        (setting,) = chosen((formulation,), weights)
    return replace(setting, plan=replace(setting.plan, sampling=sampling))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", type=Path, help="folder of ttus-opt experiment")
    parser.add_argument("--patients", nargs="+", help="names; by default all three")
    parser.add_argument("--draws", type=int, default=6, help="draws of all noise")
    parser.add_argument("--formulation", default="coulomb_global")
    parser.add_argument("--sampling", default="contact-size")
    parser.add_argument("--weights", choices=(GIVEN, AUTO), default=GIVEN)
    parser.add_argument("--shape", default="48,120,60")
    parser.add_argument("--resolution", type=float, default=1.4)
    parser.add_argument("--keep", type=Path, help="file of finished draws, to continue")
    options = parser.parse_args()
    warnings.simplefilter("ignore", tt.TtusWarning)
    scans = sorted(options.results.glob("scan-*.nc"))
    everyone = patients(tt.Surface.load(scans[0]) if scans else None)
    n_r, n_theta, n_z = (int(n) for n in options.shape.split(","))
    setting = setting_of(options.formulation, options.sampling, options.weights)
    repetition = Repetition(
        options.results, setting, (n_r, n_theta, n_z), options.resolution, options.keep
    )
    wanted = options.patients or [each.name for each in everyone]
    rows: list[Row] = []
    for each in everyone:
        if each.name in wanted:
            rows += repetition.rows(each, range(options.draws))
    print(table(rows))


if __name__ == "__main__":
    main()
