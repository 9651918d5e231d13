"""Scenes from the command line: what is wrong with recordings, in a line."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ttus_opt.core.errors import (
    InputError,
    MistakeWarning,
    TtusError,
    TtusWarning,
    warn,
)

if TYPE_CHECKING:
    from ttus_opt.cli.recording_options import ProbeOptions, RecordingOptions
    from ttus_opt.contact.scene import Scene, ScenePlan
    from ttus_opt.probe.conventions import Conventions
    from ttus_opt.probe.point_shell import PointShell
    from ttus_opt.probe.trajectory import Trajectory
    from ttus_opt.scan.surface import Surface
    from ttus_opt.voxmap.voxmap import Voxmap


def built_scene(
    plan: ScenePlan,
    parts: tuple[Surface, PointShell, Trajectory],
    reading: tuple[Trajectory, Conventions],
) -> Scene:
    """The scene; where there is none, why, and what mistake is likely behind it.

    Args:
        plan: How it is built.
        parts: Patient, probe and recordings.
        reading: The recordings as written, and how they were read.

    Raises:
        InputError: As in `ScenePlan.build`, or no pose touches the patient.
    """
    from ttus_opt.fitting.checks.frame_check import scene_in_contact
    from ttus_opt.fitting.checks.sanity import likely_mistake
    from ttus_opt.fitting.uncertainty.contact_spread import warn_of_one_spot

    try:
        built = scene_in_contact(plan, *parts)
    except InputError as error:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", TtusWarning)  # they were said before
                scene = replace(plan, inner=1.0).build(*parts)
        except InputError:
            raise error from None  # it is not the recordings
        known = scene.trajectory.has_wrench
        mistake = likely_mistake(scene, *reading)[1] if known else None
        if mistake is None:
            raise
        raise InputError(f"{error}; {mistake}") from error
    warn_of_one_spot(built)
    return built


class Measured(NamedTuple):
    """What several commands begin with.

    Attributes:
        patient: The surface.
        shell: The probe.
        recorded: The recordings in the patient's frame.
        reading: The recordings as written, and how they were read.
        scene: All of it, assembled.
    """

    patient: Surface
    shell: PointShell
    recorded: Trajectory
    reading: tuple[Trajectory, Conventions]
    scene: Scene


def measured(
    surface: Path,
    probe: ProbeOptions,
    recordings: RecordingOptions,
    plan: ScenePlan,
    begin: Callable[[str], None],
) -> Measured:
    """Read a patient, a probe and recordings, assemble their scene, warn of mistakes.

    Args:
        surface: Surface file.
        probe: The probe.
        recordings: The recordings.
        plan: How the scene is built.
        begin: Called with each of the two stages.

    Raises:
        InputError: As `built_scene`, a file that cannot be used, or no forces.
    """
    from ttus_opt.scan.surface import Surface

    begin("reading surface and recordings")
    patient, shell = Surface.load(surface), probe.read()
    reading = recordings.as_written(), recordings.conventions
    recorded = recordings.read(reading[0], shell, patient)
    recordings.require_forces(recorded)
    begin("assembling (first run compiles)")
    scene = built_scene(plan, (patient, shell, recorded), reading)
    warn_of_mistake(scene, reading)
    return Measured(patient, shell, recorded, reading, scene)


def warn_of_mistake(scene: Scene, reading: tuple[Trajectory, Conventions]) -> None:
    """Warn of a likely mistake in how recordings were read, such as a wrong sign.

    Args:
        scene: With measured forces.
        reading: The recordings as written, and how they were read.
    """
    from ttus_opt.fitting.checks.sanity import likely_mistake

    _, mistake = likely_mistake(scene, *reading)
    if mistake is not None:
        warn(str(mistake), kind=MistakeWarning)


def scene_of_field(
    voxmap: Voxmap, shell: PointShell, recorded: Trajectory
) -> Scene | None:
    """A coarse scene on the patient of a field, for `warn_of_mistake`.

    None where a coarse grid does not resolve the patient.
    """
    from ttus_opt.contact.scene import ScenePlan
    from ttus_opt.fitting.weights.coarse_scene import coarse_shape

    grid = voxmap.grid
    plan = ScenePlan(
        coarse_shape(grid.shape),
        grid.r_inner,
        grid.r_outer,
        inner=1.0,
        boundary=voxmap.boundary,
        sector=grid.sector,
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TtusWarning)  # of poses: they are said
            return plan.build(voxmap.surface, shell, recorded)
    except TtusError:
        return None
