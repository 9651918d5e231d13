"""The whole method on the bundled example: from the scan to surface, field and errors.

The field is fitted to two recordings (pushes, and lines along the body) and evaluated
on them and on two unseen ones of the same kinds. The demo compares the Laplace prior
alone with eq. 10, whose weights are chosen from the fitted recordings alone.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt import example
from ttus_opt.contact.scene import Scene, ScenePlan
from ttus_opt.core.arrays import Array
from ttus_opt.fitting.batch import fit
from ttus_opt.fitting.weights.weight_choice import AUTO, checked_word, choice_of
from ttus_opt.laplace.multigrid.ahead import compiling_ahead
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import read_trajectory
from ttus_opt.report.document import Heading, Items, Picture, write_report
from ttus_opt.report.tables import Comparison, error_section
from ttus_opt.scan.cloud import read_cloud
from ttus_opt.scan.extraction import extract_surface
from ttus_opt.scan.surface import Surface
from ttus_opt.session.model import judge

if TYPE_CHECKING:
    from ttus_opt.problem.solution import Solution
    from ttus_opt.voxmap.field import PotentialField

#: Number of stages that `run` reports
N_STAGES = 8

FITTED, UNSEEN = ("press_fit", "sweep_fit"), ("press_test", "sweep_test")

PICTURES = {
    "surface.png": "Surface from the scan, seen and filled",
    "potential.png": "Potential before and after fitting",
    "force_press_test.png": "Pushes the field has not seen",
    "force_sweep_test.png": "Lines along the body the field has not seen",
    "residuals.png": "Residuals on unseen motion",
    "overview.png": "The method in one picture",
}


@dataclass(frozen=True)
class SurfaceError:
    """Error of the extracted radius where the scan saw the surface.

    Attributes:
        mean: Mean of |R - R_true| [m].
        p95: 95th percentile of |R - R_true| [m].
        observed: Fraction of the radii that were seen [–].
    """

    mean: float
    p95: float
    observed: float


@dataclass(frozen=True)
class DemoResult:
    """Result of the demo.

    Attributes:
        comparisons: Errors before and after fitting, one per recording.
        before: Solution of the Laplace prior alone.
        after: Solution with forces and torques.
        surface_error: Error of the surface extracted from the scan.
        seconds: Duration of the run, until the report is written [s].
    """

    comparisons: tuple[Comparison, ...]
    before: Solution = field(repr=False)
    after: Solution = field(repr=False)
    surface_error: SurfaceError
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """All figures by name, for JSON."""
        return {
            **self.after.as_dict(),
            "surface_error_mean_m": self.surface_error.mean,
            "surface_error_p95_m": self.surface_error.p95,
            "surface_observed": self.surface_error.observed,
            "seconds": self.seconds,
            "errors": [case.as_dict() for case in self.comparisons],
        }


def run(
    folder: str | os.PathLike[str],
    *,
    shape: tuple[int, int, int] = (48, 120, 60),
    weights: str = AUTO,
    progress: Callable[[str], None] | None = None,
) -> DemoResult:
    """Run the method and write surface, field, pictures and report.

    Args:
        folder: Output folder, created if missing.
        shape: Voxels in r, θ and z [–].
        weights: Weights of eq. 10, "auto" or "own", see `ttus_opt.fit`.
        progress: Called with the name of each of the `N_STAGES` stages as it begins.

    Raises:
        InputError: The grid or the word for the weights is invalid.
        NoSolutionError: A fit failed its own check.
        FileError: The folder cannot be written to.
    """
    checked_word(weights)
    start = time.perf_counter()
    begin = progress or (lambda stage: None)
    out = Path(folder)
    with compiling_ahead():
        begin("reading the example")
        truth = Surface.load(example.path("surface.nc"))
        cloud = read_cloud(example.path("scan.ply"), unit="m")
        recordings = {
            name: read_trajectory(example.path(f"{name}.csv"))
            for name in (*FITTED, *UNSEEN)
        }
        shell = PointShell.from_spec(example.PROBE)
        begin("scan to surface")
        surface = extract_surface(cloud, axis=truth.axis)
        surface.save(out / "surface.nc")
        _draw_surface(out, surface, cloud)  # the multigrid is compiled meanwhile
        begin("assembling (first run compiles)")
        plan = ScenePlan(shape=shape, inner="fit", sampling="trilinear")
        scene = plan.build(surface, shell, [recordings[name] for name in FITTED])
        begin("Laplace prior alone")
        before = fit(scene, "laplace_only")
    begin("choosing weights")
    choice = choice_of(weights, scene, "eq10")
    begin("with forces and torques")
    after = replace(fit(choice.scene, choice.formulation), chosen=choice.lines)
    begin("evaluating")
    fields = before.field, after.field
    comparisons = judge(fields, shell, recordings, FITTED)
    begin("pictures and report")
    after.field.save(out / "field.nc")
    pictures = _pictures(cloud, *fields, comparisons)
    error = surface_error(surface, truth)
    result = DemoResult(comparisons, before, after, error, time.perf_counter() - start)
    facts = [f"{name}: {what}" for name, what in _facts(scene, result).items()]
    head = [Heading("Report", 1), Items(facts), *error_section(comparisons)]
    write_report(out, [*head, Heading("Pictures"), *pictures])
    return result


def surface_error(surface: Surface, truth: Surface) -> SurfaceError:
    """Compare an extracted surface with the true one where the scan saw it.

    Args:
        surface: The surface extracted from a scan.
        truth: The true surface, in the same patient frame.
    """
    theta, z = np.meshgrid(surface.theta, surface.z, indexing="ij")
    known = surface.observed & (z >= truth.z[0]) & (z <= truth.z[-1])
    wrong = np.abs(surface.radius - truth.radius_at(theta, z))[known]
    return SurfaceError(
        float(wrong.mean()),
        float(np.percentile(wrong, 95)),
        float(surface.observed.mean()),
    )


def _draw_surface(out: Path, surface: Surface, cloud: Array) -> None:
    from ttus_opt.report import plots

    figure = plots.surface_picture(surface, cloud)
    plots.save_picture(figure, out / "surface.png")


def _pictures(
    cloud: Array,
    before: PotentialField,
    after: PotentialField,
    comparisons: tuple[Comparison, ...],
) -> list[Picture]:
    from ttus_opt.report import plots

    unseen = {case.recording: case for case in comparisons if not case.seen}
    pair = {
        name: {"Laplace alone": case.before, "fitted": case.after}
        for name, case in unseen.items()
    }
    figures = {
        "potential.png": plots.potential_slices(before, after),
        "residuals.png": plots.residual_histogram(
            [case.before for case in unseen.values()],
            [case.after for case in unseen.values()],
        ),
        "overview.png": plots.overview(after, cloud, pair["press_test"]),
    }
    for name, evaluations in pair.items():
        figures[f"force_{name}.png"] = plots.force_over_time(
            evaluations, PICTURES[f"force_{name}.png"]
        )
    return [Picture(name, told, figures.get(name)) for name, told in PICTURES.items()]


def _facts(scene: Scene, result: DemoResult) -> dict[str, str]:
    after, error = result.after, result.surface_error
    kkt = after.kkt
    shape = " x ".join(map(str, scene.voxmap.grid.shape))
    return {
        "Surface": f"{100 * error.observed:.0f} % of the radii seen; where seen, off "
        f"by {1e3 * error.mean:.1f} mm in the mean and {1e3 * error.p95:.1f} mm at "
        "the 95th percentile",
        "Grid": f"{shape} = {scene.n_voxels:,} voxels, trilinear sampling",
        "Fit": f"{after.formulation} with λ_f = {after.weights['force']:.2g}, "
        f"λ_τ = {after.weights['torque']:.2g} and ℓ = "
        f"{1e3 * scene.torque_length:.1f} mm to {len(scene.trajectory)} poses "
        f"({', '.join(FITTED)}), by {after.solver}",
        "Chosen": "; ".join(after.chosen),
        "Check": "worst relative KKT residual "
        + ("unknown" if kkt is None else f"{kkt.worst_relative:.1e}"),
        "Identified": ", ".join(after.identified),
        "Time": f"{after.timings.assembly:.1f} s assembly, "
        f"{after.timings.setup + after.timings.solve:.1f} s solve, "
        f"{result.seconds:.0f} s in all",
    }
