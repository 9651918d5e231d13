"""Noise or missing recordings: what an error of `ttus-opt experiment` is due to.

    ttus-opt experiment --torso ct_skin_mm.ply -o results
    python benchmarks/experiment_causes.py results --patient scanned

One formulation is fitted to variants of a patient's recordings: with the noise of the
wrenches alone, of the poses alone, with neither, with the unseen recordings among the
fitted ones; with other draws of all noise; and with further sweeps. Every row judges
the new trajectories against true wrenches: median error of the force's magnitude, mean
angle, error of the torque, and how many of the eight aims are met. "Too deep" is by how
much the poses of the fitted press and sweep are reported too deep, on average over the
frames in contact. For understanding, not for choosing: it uses what no laboratory
knows.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

import ttus_opt as tt
from ttus_opt.contact.scene import ScenePlan
from ttus_opt.experiment.fits import FITTED, meets
from ttus_opt.experiment.patients import (
    PROBE,
    PROBE_SPEC,
    Examination,
    Patient,
    examine,
    patients,
    skin_file,
)
from ttus_opt.experiment.settings import compared
from ttus_opt.phantom.elasticity import SkinPatch
from ttus_opt.phantom.examination import sweep_handling
from ttus_opt.phantom.press import CoulombDrag
from ttus_opt.phantom.recording import add_noise, add_pose_noise, record
from ttus_opt.report.metrics import FORCE_THRESHOLD

UNSEEN = ("press_test", "sweep_test")

#: Seeds of other draws and of further sweeps, away from those of the patients
OTHER_DRAW, FURTHER = 900_000, 800_000

#: Middle of the fitted sweep and of the unseen one, from the middle of the front [m]
FITTED_SIDE, UNSEEN_SIDE = -0.006, 0.006


@dataclass(frozen=True)
class Study:
    """A patient, and how fields are fitted to variants of its recordings.

    Attributes:
        examination: The patient's recordings.
        folder: The patient's part of the experiment's results.
        resolution: Of its finite elements.
        shape: Voxels in r, θ and z [–].
        formulation: What is fitted, by weights of 1 where it does not choose its own.
        sampling: Of the field.
        refine: Whether poses are refined by the forces before a fit.
    """

    examination: Examination
    folder: Path
    resolution: float
    shape: tuple[int, int, int]
    formulation: str
    sampling: str
    refine: bool = False

    @property
    def patient(self) -> Patient:
        """The patient."""
        return self.examination.patient

    @cached_property
    def _patch(self) -> SkinPatch:
        return SkinPatch.load(skin_file(self.patient, self.folder, self.resolution))

    def fitted(self, kind: str) -> list[tt.Trajectory]:
        """Both fitted recordings of a kind, ``measured`` or ``true``."""
        own = getattr(self.examination, kind)
        return [own[name] for name in FITTED]

    def drawn(self, true: tt.Trajectory, seed: int) -> tt.Trajectory:
        """A true recording with noise of its poses and its wrenches."""
        rng = np.random.default_rng(seed)
        return add_noise(add_pose_noise(true, rng), rng)

    def further_sweep(self, side: float, seed: int) -> tt.Trajectory:
        """A further sweep, with noise."""
        rng = np.random.default_rng(FURTHER + seed)
        motion = sweep_handling(rng, across=side, depth=self.patient.sweep_depth)
        true = record(
            self._patch,
            PROBE,
            motion.poses(self.patient.torso, PROBE),
            drag=CoulombDrag(self.patient.drag),
            damping=self.patient.damping,
        )
        return self.drawn(true, FURTHER + seed + 1)

    def row(self, name: str, recordings: Sequence[tt.Trajectory]) -> str:
        """Fit and judge."""
        plan = ScenePlan(self.shape, sampling=self.sampling)
        shell = tt.PointShell.from_spec(PROBE_SPEC)
        scene = plan.build(self.examination.surface, shell, list(recordings))
        if self.refine:
            recordings = tt.refine_poses(scene).recordings
            scene = plan.build(self.examination.surface, shell, recordings)
        (setting,) = compared((self.formulation,), 1.0)
        solution = tt.fit(scene, self.formulation, **setting.options)
        mu = solution.parameters.get("friction_coefficient", 0.0)
        off = zip(recordings, self.fitted("true"), strict=False)
        deep = " / ".join(f"{1e3 * too_deep(*pair):.2f}" for pair in off)
        cells, met = [name, deep, f"{mu:.3f}"], 0
        for unseen in UNSEEN:
            true = self.examination.true[unseen]
            score = tt.evaluate(solution.field, shell, true).errors
            met += sum(meets(score).values())
            cells += [
                f"{score.force_median_N:.2f} N, {100 * score.force_median_share:.1f} %",
                f"{score.force_angle_error_deg:.1f}°",
                f"{100.0 * score.torque_share:.0f} %",
            ]
        return f"| {' | '.join([*cells, str(met)])} |"

    def variants(self, draws: int) -> Iterator[tuple[str, list[tt.Trajectory]]]:
        """Rows of the table: a name, and what is fitted."""
        measured, true = self.fitted("measured"), self.fitted("true")
        yield "as measured", measured
        exact = [
            replace(m, force=t.force, torque=t.torque)
            for m, t in zip(measured, true, strict=True)
        ]
        yield "wrenches without noise", exact
        placed = [
            replace(m, position=t.position, rotation=t.rotation)
            for m, t in zip(measured, true, strict=True)
        ]
        yield "poses without noise", placed
        level = [raised(m, too_deep(m, t)) for m, t in zip(measured, true, strict=True)]
        yield "as measured, at the right depth on average", level
        itself = [self.examination.itself[name] for name in FITTED]
        yield "wrenches as exact for the reported poses", itself
        yield "neither with noise", true
        unseen = [self.examination.true[name] for name in UNSEEN]
        yield "neither, unseen recordings fitted too", [*true, *unseen]
        for k in range(draws):
            seeds = (OTHER_DRAW + 1000 * k, OTHER_DRAW + 1000 * k + 10)
            pairs = zip(true, seeds, strict=True)
            yield f"other draw of noise, {k + 1}", [self.drawn(*p) for p in pairs]
        beside = [self.further_sweep(FITTED_SIDE, 100 * k) for k in range(3)]
        other = [self.further_sweep(UNSEEN_SIDE, 1000 + 100 * k) for k in range(3)]
        for side, more in (("the fitted", beside), ("the unseen", other)):
            for n in (1, 3):
                yield (
                    f"as measured, {n} more on {side} side",
                    [*measured, *more[:n]],
                )


def too_deep(reported: tt.Trajectory, true: tt.Trajectory) -> float:
    """Mean error of the reported depth along the force, in contact [m]."""
    assert true.force is not None
    size = np.linalg.norm(true.force, axis=1)
    touching = size > FORCE_THRESHOLD
    outward = true.force[touching] / size[touching, None]
    off = (reported.position - true.position)[touching]
    return -float(np.einsum("ij,ij->i", off, outward).mean())


def raised(reported: tt.Trajectory, height: float) -> tt.Trajectory:
    """A recording moved out of the body by a height [m], along the probe's z axis."""
    position = reported.position - height * reported.rotation[:, :, 2]
    return replace(reported, position=position)


def studied(options: argparse.Namespace) -> Study:
    """The patient's recordings, from the experiment's cache where they are there."""
    scans = sorted(options.results.glob("scan-*.nc"))
    scan = tt.Surface.load(scans[0]) if scans else None
    everyone = {each.name: each for each in patients(scan)}
    patient = everyone[options.patient]
    folder = options.results / patient.name
    examination = examine(patient, folder, options.resolution)
    n_r, n_theta, n_z = (int(n) for n in options.shape.split(","))
    fitted = options.formulation, options.sampling, options.refine
    shape = (n_r, n_theta, n_z)
    return Study(examination, folder, options.resolution, shape, *fitted)


def main() -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", type=Path, help="folder of ttus-opt experiment")
    parser.add_argument("--patient", default="scanned")
    parser.add_argument("--formulation", default="coulomb_global")
    parser.add_argument("--sampling", default="trilinear")
    parser.add_argument("--refine", action="store_true", help="refine poses by forces")
    parser.add_argument("--draws", type=int, default=5, help="other draws of noise")
    parser.add_argument("--only", default="", help="rows whose name contains this")
    parser.add_argument("--shape", default="48,120,60")
    parser.add_argument("--resolution", type=float, default=1.4)
    options = parser.parse_args()
    warnings.simplefilter("ignore", tt.TtusWarning)
    study = studied(options)
    print("| fitted | too deep [mm] | μ | press | | | sweep | | | aims met |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name, recordings in study.variants(options.draws):
        if options.only in name:
            print(study.row(name, recordings), flush=True)


if __name__ == "__main__":
    main()
