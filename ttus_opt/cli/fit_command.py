"""``ttus-opt fit``: from surface, probe and recorded wrenches to a field."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ttus_opt.cli.console import Stages, tell
from ttus_opt.cli.recording_options import ProbeOptions, RecordingOptions
from ttus_opt.cli.scene_building import built_scene
from ttus_opt.cli.scene_options import ProblemOptions, SceneOptions
from ttus_opt.cli.sources import fitted_contacts, sources
from ttus_opt.core import io
from ttus_opt.core.errors import InputError, MistakeWarning, warn

if TYPE_CHECKING:
    from ttus_opt.contact.scene import Scene
    from ttus_opt.fitting.weights.weight_choice import WeightChoice
    from ttus_opt.probe.conventions import Conventions
    from ttus_opt.probe.point_shell import PointShell
    from ttus_opt.probe.trajectory import Trajectory
    from ttus_opt.problem.solution import Solution
    from ttus_opt.scan.surface import Surface
    from ttus_opt.voxmap.field import PotentialField


#: Potential in double precision and region of a field file [byte]
BYTES_PER_VOXEL = 9

#: Most that a field file is taken to need before the work [byte]
LARGEST_FILE = 2**31

#: Share of the command's time after which a solver stops by itself [–]
SOLVING = 0.9

#: Shortest time limit of a solve [s]
SHORTEST = 1e-3


@dataclass(frozen=True)
class WeightOptions:
    """Where weights come from, as typed.

    Attributes:
        force_weight: Weight λ_f of forces. Giving it turns the choice of weights off.
        torque_weight: Weight λ_τ of torques. Giving it turns the choice of weights off.
        weights: auto: choose weights and boundary scale of a formulation by places left
            out, as ttus-opt tune does. own: the formulation's, 0.01. By default auto if
            no weight is given.
        paper: Use the paper's choices unless you give others: --inner 1 --sampling
            voxel-mean --boundary staircase --force-weight 1e-4 --torque-weight 1e-4.
    """

    force_weight: float | None = None
    torque_weight: float | None = None
    weights: str | None = None
    paper: bool = False

    def options(
        self, problem: ProblemOptions, torque_length: float | None
    ) -> dict[str, Any]:
        """Options of the formulation that were given, or are the paper's."""
        named = {
            "force_weight": self.force_weight,
            "torque_weight": self.torque_weight,
            "torque_length": torque_length,
        }
        given = {name: value for name, value in named.items() if value is not None}
        given |= problem.further
        if not self.paper:
            return given
        from ttus_opt.core.paper import WEIGHTS
        from ttus_opt.problem.formulation import option_defaults

        known = option_defaults(problem.name)
        usual = {n: w for n, w in WEIGHTS.items() if known is None or n in known}
        return usual | given


def fit(
    context: typer.Context,
    surface: Path,
    probe: ProbeOptions,
    recordings: RecordingOptions,
    output: Path,
    problem: ProblemOptions,
    grid: SceneOptions,
    weighting: WeightOptions,
    every: int = 1,
    rate: float | None = None,
    torque_length: float | None = None,
    time_limit: float = 600.0,
    picture: Path | None = None,
    uncertainty: bool = False,
    uncertainty_picture: Path | None = None,
) -> None:
    """Fit a potential field to measured forces and torques.

    Args:
        output: Field file (.nc).
        every: Use only every n-th frame of a recording.
        rate: Use at most this many frames per second of a recording [Hz].
        torque_length: Length ℓ that scales torques to forces [m]. By default the
            probe's.
        time_limit: Time limit of the command [s]; the solver is given what is left of
            it when the weights are chosen.
        picture: Draw the probe on the skin with the measured forces here.
        uncertainty: Save the field's uncertainty in the field file, for ttus-opt
            evaluate --uncertainty and for rendering.
        uncertainty_picture: Draw here where the patient was measured and where the
            model only guesses; implies --uncertainty.

    Example:
        ttus-opt fit --surface surface.nc --probe ellipsoid:0.030,0.0125,0.018
        --trajectory press_fit.csv -o field.nc
    """
    from ttus_opt.fitting.checks.sanity import check_recordings
    from ttus_opt.fitting.weights.weight_choice import OWN, choice_of, word_for
    from ttus_opt.probe.trajectory import thinned
    from ttus_opt.scan.surface import Surface

    if weighting.paper and weighting.weights == "auto":
        raise InputError("--paper sets the weights: leave --weights out")
    problem.check()
    deadline = time.monotonic() + SOLVING * time_limit
    options = weighting.options(problem, torque_length)
    if weighting.paper:
        grid = grid.as_in_the_paper()
    word = word_for(weighting.weights, problem.formulation, options)
    conventions, plan = recordings.conventions, grid.plan
    # a grid beyond any memory is refused for that, in words of its own
    size = min(BYTES_PER_VOXEL * math.prod(plan.shape), LARGEST_FILE)
    io.check_output(output, size=size)
    with Stages(5 + (word != OWN) + (picture is not None)) as begin:
        begin("reading surface and recordings")
        patient = Surface.load(surface)
        as_written = thinned(recordings.as_written(), every=every, rate=rate)
        shell = probe.read()
        recorded = recordings.read(as_written, shell, patient)
        recordings.require_forces(recorded, problem.name)
        if picture is not None:  # before the fit: it may tell why there is none
            begin("drawing")
            _draw_poses(patient, shell, recorded, recordings.names, picture)
        begin("assembling (first run compiles)")
        scene = built_scene(plan, (patient, shell, recorded), (as_written, conventions))
        if word != OWN:
            begin("choosing weights")
        choice = choice_of(
            word,
            scene,
            problem.formulation,
            options,
            sampling=grid.sampling,
            strict=weighting.weights is not None,
        )
        begin("solving")
        solution = _solved(choice, problem, deadline)
        report = None
        if solution.verified_field is not None:
            found = solution.field
            origin = {
                **sources(surface, probe, recordings, context.params),
                **fitted_contacts(patient, shell, recorded),
            }
            draws = uncertainty or uncertainty_picture is not None
            begin("checking the recordings")
            report = check_recordings(
                choice.scene,
                found,
                recordings.names,
                written=as_written,
                conventions=conventions,
            )
            if report.mistake is not None:
                warn(str(report.mistake), kind=MistakeWarning)
            begin("writing the field" + draws * " and drawing from its posterior")
            _write(
                replace(found, provenance={**found.provenance, **origin}),
                *(solution, choice.scene, output, (uncertainty, uncertainty_picture)),
            )
    lines: list[str] = []
    if report is not None:
        lines = [*solved_lines(solution, output), *solution.chosen, *report.lines]
        lines += how_read(recorded, conventions)
    tell(
        {
            **solution.as_dict(),
            "output": None if solution.verified_field is None else str(output),
            "weights_chosen": choice.as_dict(),
            "sanity": None if report is None else report.as_dict(),
        },
        *lines,
    )
    solution.field  # noqa: B018  raises what is wrong when nothing was verified


def _solved(choice: WeightChoice, problem: ProblemOptions, deadline: float) -> Solution:
    from ttus_opt.fitting.batch import fit as fit_scene

    solution = fit_scene(
        choice.scene,
        choice.formulation,
        solver=problem.solver,
        tolerance=problem.tolerance,
        time_limit=max(deadline - time.monotonic(), SHORTEST),
    )
    return replace(solution, chosen=choice.lines)


def _write(
    found: PotentialField,
    solution: Solution,
    scene: Scene,
    output: Path,
    wanted: tuple[bool, Path | None],
) -> None:
    """Write the field; with its uncertainty and a picture of it where asked for.

    A `TtusWarning` says why where there is no uncertainty.
    """
    asked, picture = wanted
    if not asked and picture is None:
        found.save(output)
        return
    from ttus_opt.fitting.uncertainty.field_uncertainty import uncertainty
    from ttus_opt.fitting.uncertainty.saved_uncertainty import save_with_uncertainty
    from ttus_opt.report import plots

    try:
        saved = save_with_uncertainty(found, uncertainty(solution, scene), output)
    except InputError as error:
        found.save(output)
        warn(f"{output} was written without uncertainty: {error}")
        return
    if picture is not None:
        assert saved.uncertainty is not None
        figure = plots.uncertainty_picture(saved.uncertainty, scene.trajectory)
        plots.save_picture(figure, picture)


def _draw_poses(
    patient: Surface,
    shell: PointShell,
    recorded: Trajectory,
    names: Sequence[str],
    picture: Path,
) -> None:
    """Draw them; a file may have several recordings."""
    from ttus_opt.fitting.checks.sanity import recording_names
    from ttus_opt.report import plots

    own = recording_names(names, len(set(recorded.segment.tolist())))
    plots.save_picture(plots.pose_picture(patient, shell, recorded, own), picture)


def solved_lines(solution: Solution, output: Path) -> list[str]:
    """How it was solved, for people."""
    worst = float("nan") if solution.kkt is None else solution.kkt.worst_relative
    times = solution.timings
    after = f" after {', '.join(map(str, solution.attempts))}"
    costs = ", ".join(f"{name} {cost:.4g}" for name, cost in solution.costs.items())
    solved = (
        f"{output}: {solution.formulation} by {solution.solver}"
        f"{after if solution.attempts else ''}, "
        f"{solution.n_voxels:,} voxels, KKT {worst:.1e}, "
        f"{times.assembly:.1f} s assembly, {times.setup + times.solve:.1f} s solve"
        + (f", {times.compile:.1f} s compile" if times.compile > 0.05 else "")
    )
    compressed = [
        f"{name}: {had:,} rows compressed to {has:,}, exactly"
        for name, (had, has) in solution.compressed.items()
    ]
    objective = f"objective {solution.objective:.4g} ({costs})"
    return [solved, objective, *compressed, *solution.identified]


def how_read(recorded: Trajectory, conventions: Conventions) -> list[str]:
    """What was taken for granted of the recordings, in words."""
    frame, axes = conventions.frame, conventions.wrench_frame
    about = conventions.torque_about
    if not isinstance(about, str):
        about = ",".join(f"{v:g}" for v in about)
    torques = f"torques about: {about}"
    if not recorded.has_torque:
        torques = "no torques were measured: forces alone were fitted"
    return [f"poses in the {frame}'s frame, wrenches in the {axes}'s axes", torques]
