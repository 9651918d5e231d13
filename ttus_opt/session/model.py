"""Sixth and seventh step of a session: a field is fitted and tested."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from ttus_opt.contact.scene import Scene, ScenePlan
from ttus_opt.core.errors import MistakeWarning, warn
from ttus_opt.fitting.batch import fit
from ttus_opt.fitting.checks.frame_check import scene_in_contact
from ttus_opt.fitting.checks.other_readings import contact_readings
from ttus_opt.fitting.checks.sanity import likely_mistake
from ttus_opt.fitting.uncertainty.contact_spread import warn_of_one_spot
from ttus_opt.fitting.weights.weight_choice import WeightChoice, choice_of
from ttus_opt.probe.conventions import Conventions
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.metrics import evaluate
from ttus_opt.report.tables import Comparison
from ttus_opt.scan.surface import Surface
from ttus_opt.session.description import Description

if TYPE_CHECKING:
    from ttus_opt.problem.solution import Solution
    from ttus_opt.voxmap.field import PotentialField

#: Keys of the description that a mistake is made in, by its cause
KEYS = {
    "flip_wrench": "force.sensor.sign",
    "wrench_frame": "force.frame or force.sensor.axes",
    "wrench_axes": "force.frame, force.sensor.axes and tracker.probe_to_target",
    "probe_axes": "tracker.probe_to_target",
    "wrench_delay": "clock.offset",
    "torque_about": "force.sensor.point",
    "torque_unit": "the unit of force.file",
}


@dataclass(frozen=True)
class Model:
    """A fitted field, with the Laplace prior alone for comparison.

    Attributes:
        before: The prior, its boundary scaled to the forces.
        after: The fitted field.
        choice: Its weights, and how they were chosen.
    """

    before: Solution = field(repr=False)
    after: Solution
    choice: WeightChoice


def fit_model(
    session: Description,
    surface: Surface,
    shell: PointShell,
    recordings: Mapping[str, Trajectory],
) -> Model:
    """Fit a field to the stretches with use: fit.

    Args:
        session: The description.
        surface: Surface of the patient.
        shell: The probe.
        recordings: All stretches, by name.

    Raises:
        InputError: An invalid grid, formulation or solver, or no pose touches the
            patient.
        NoSolutionError: The answer failed its verification.
    """
    plan = ScenePlan(session.fit.shape, session.fit.r_inner)
    fitted = [recordings[name] for name in session.fitted]
    scene = scene_in_contact(plan, surface, shell, fitted)
    _judge_recordings(scene)
    before = fit(scene, "laplace_only")
    wanted = session.fit
    given = wanted.weights, scene, wanted.formulation, wanted.options
    choice = choice_of(*given, strict=False)
    after = fit(choice.scene, choice.formulation, solver=wanted.solver)
    after = replace(after, chosen=choice.lines)
    for solution in (before, after):
        _ = solution.field  # raises where verification failed
    return Model(before, after, choice)


def _judge_recordings(scene: Scene) -> None:
    """Warn of likely mistakes in the description, by its keys."""
    warn_of_one_spot(scene)
    if not scene.trajectory.has_wrench:
        return
    recorded = scene.trajectory, Conventions()
    _, mistake = likely_mistake(scene, *recorded, contact_readings(scene))
    if mistake is not None:
        key = f"check {KEYS[mistake.cause]} in the description"
        warn(mistake.told(key), kind=MistakeWarning)


def judge(
    fields: tuple[PotentialField, PotentialField],
    shell: PointShell,
    recordings: Mapping[str, Trajectory],
    fitted: Collection[str],
) -> tuple[Comparison, ...]:
    """Errors of the fields before and after fitting, along every recording."""
    return tuple(
        Comparison(name, name in fitted, *(evaluate(p, shell, case) for p in fields))
        for name, case in recordings.items()
    )
