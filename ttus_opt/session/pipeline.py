"""A session from end to end, step by step."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ttus_opt.fitting.checks.frame_check import warn_of_jumps
from ttus_opt.laplace.multigrid.ahead import compiling_ahead
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.tables import Comparison
from ttus_opt.sensors.stream_files import read_wrenches
from ttus_opt.sensors.streams import with_wrenches
from ttus_opt.sensors.tool_load import ToolLoad
from ttus_opt.session.description import Description, read_description
from ttus_opt.session.model import Model, fit_model, judge
from ttus_opt.session.readings import (
    Timing,
    contact_wrenches,
    cut,
    synchronise,
)
from ttus_opt.session.registration import Registration, probe_poses, register
from ttus_opt.session.results import STEPS, Results
from ttus_opt.session.skin import Skin, find_skin

#: How often `run_session` reports progress
N_STAGES = len(STEPS)


@dataclass(frozen=True)
class SessionResult:
    """What a session found.

    Attributes:
        folder: Folder of the results.
        session: The description.
        skin: The patient's surface.
        registration: Motions between the frames.
        timing: The offset between the clocks.
        load: Subtracted from raw readings; None where they were compensated already.
        recordings: Contact wrenches, patient frame, by name.
        model: The fields.
        comparisons: Errors before and after fitting, per recording.
        figures: All figures by name, as in ``session.json``.
    """

    folder: Path
    session: Description = field(repr=False)
    skin: Skin = field(repr=False)
    registration: Registration = field(repr=False)
    timing: Timing
    load: ToolLoad | None
    recordings: dict[str, Trajectory] = field(repr=False)
    model: Model
    comparisons: tuple[Comparison, ...] = field(repr=False)
    figures: dict[str, Any] = field(default_factory=dict, repr=False)

    def as_dict(self) -> dict[str, Any]:
        """All figures by name, for JSON."""
        return self.figures


def run_session(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    progress: Callable[[str], None] | None = None,
    trust: bool = False,
) -> SessionResult:
    """From a recording folder to surface, trajectories, field, errors and a report.

    Args:
        path: The folder with its ``session.yaml``, or that file
            (``docs/how-to/session.md``).
        output: Folder of the results; created if missing. Every step writes its files
            when it is complete, and ``session.json`` lists the complete steps.
        progress: Called with the name of every step that begins, `N_STAGES` times.
        trust: Whether the description may name files of Python code, a formulation or
            a solver, which are then executed.

    Raises:
        FileError: A file is missing or damaged, or the description is invalid; nothing
            is written.
        InputError: Recordings that contradict each other; the message names the step.
        NoSolutionError: The answer failed its verification.
    """
    session = read_description(path, trust=trust)
    results = Results(output, progress or (lambda step: None))
    streams = session.tracker.stream.file, session.force.stream.file
    tags = [] if session.tracker.tags is None else [session.tracker.tags]
    results.check([session.file, *session.scan.files, *streams, *tags])
    shell = PointShell.from_spec(session.probe, unit=session.probe_unit)
    with compiling_ahead():
        return _run(session, shell, results)


def _run(session: Description, shell: PointShell, results: Results) -> SessionResult:
    with results.step("surface"):
        skin = find_skin(session.scan)
        skin.surface.save(results.path("surface.nc"))
        results.tell("surface", _surface_facts(skin))
    with results.step("registration"):
        frames = register(session.tracker, skin.surface)
        poses = probe_poses(session.tracker, frames)
        warn_of_jumps(poses)
        results.tell("registration", frames.facts())
    with results.step("clock"):
        stream, gap = session.force.stream, session.clock.largest_gap
        wrenches = read_wrenches(stream.file, stream.name, stream.columns)
        timing = synchronise(session, poses, wrenches, skin.surface, frames)
        joined = with_wrenches(poses, wrenches, timing.offset, largest_gap=gap)
        results.tell("clock", _clock_facts(session, timing, len(poses), len(joined)))
    begin = float(poses.time[0])
    with results.step("load"):
        contact, load = contact_wrenches(session, joined, shell, frames, begin)
        results.tell("load", {} if load is None else load.facts())
    with results.step("recordings"):
        recordings = cut(contact, session.recordings, begin)
        for name, recording in recordings.items():
            recording.save(results.path(f"recordings/{name}.csv"))
        frames_of = {name: len(each) for name, each in recordings.items()}
        results.tell("recordings", frames_of)
    with results.step("fit"):
        model = fit_model(session, skin.surface, shell, recordings)
        model.after.field.save(results.path("field.nc"))
        weights = model.choice.as_dict()
        results.tell("fit", {**model.after.as_dict(), "weights": weights})
    with results.step("evaluation"):
        fields = model.before.field, model.after.field
        comparisons = judge(fields, shell, recordings, session.fitted)
        errors = [case.as_dict() for case in comparisons]
        results.tell("evaluation", {"errors": errors})
    with results.step("report"):
        from ttus_opt.session.report import write_reports

        result = SessionResult(
            results.folder,
            session,
            skin,
            frames,
            timing,
            load,
            recordings,
            model,
            comparisons,
            results.figures,
        )
        write_reports(result, shell, results.path)
    return result


def _surface_facts(skin: Skin) -> dict[str, Any]:
    surface = skin.surface
    return {
        "points": None if skin.cloud is None else len(skin.cloud),
        "observed": float(surface.observed.mean()),
        "z_min_m": float(surface.z[0]),
        "z_max_m": float(surface.z[-1]),
        "axis_origin": surface.axis.origin,
        "axis_rotation": surface.axis.rotation,
    }


def _clock_facts(
    session: Description, timing: Timing, n_poses: int, n_joined: int
) -> dict[str, Any]:
    return {
        "by": session.clock.by,
        "offset_s": timing.offset,
        "correlation": timing.correlation,
        "frames": n_joined,
        "left_out": n_poses - n_joined,
    }
