"""Sixth and seventh step of a session: a field is fitted and tested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ttus_opt.fitting.batch import fit
from ttus_opt.fitting.weight_choice import WeightChoice
from ttus_opt.fitting.weight_words import choice_of
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.solution import Solution
from ttus_opt.report.metrics import evaluate
from ttus_opt.report.tables import Comparison
from ttus_opt.scan.surface import Surface
from ttus_opt.scene import ScenePlan
from ttus_opt.session.description import Description


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
        InputError: An invalid grid, formulation or solver.
        NoSolutionError: The answer failed its verification.
    """
    plan = ScenePlan(session.fit.shape, session.fit.r_inner)
    fitted = [recordings[part.name] for part in session.recordings if part.fitted]
    scene = plan.build(surface, shell, fitted)
    before = fit(scene, "laplace_only")
    wanted = session.fit
    choice = choice_of(wanted.weights, scene, wanted.formulation, wanted.options)
    after = fit(choice.scene, choice.formulation, solver=wanted.solver)
    after = replace(after, chosen=choice.lines)
    for solution in (before, after):
        _ = solution.field  # raises where verification failed
    return Model(before, after, choice)


def judge(
    session: Description,
    model: Model,
    shell: PointShell,
    recordings: Mapping[str, Trajectory],
) -> tuple[Comparison, ...]:
    """Errors of both fields along every stretch, by name in ``recordings``."""
    fields = model.before.field, model.after.field
    return tuple(
        Comparison(
            part.name,
            part.fitted,
            *(evaluate(each, shell, recordings[part.name]) for each in fields),
        )
        for part in session.recordings
    )
