"""``ttus-opt render``: the wrenches a field gives along a trajectory."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from ttus_opt.cli.console import Stages, tell
from ttus_opt.cli.evaluate_command import warn_of_poses
from ttus_opt.cli.recording_options import ProbeOptions, RecordingOptions
from ttus_opt.cli.sources import probe_for


def render(
    field: Path,
    probe: ProbeOptions,
    recordings: RecordingOptions,
    output: Path,
    force_limit: float = 40.0,
    torque_limit: float = 4.0,
    presliding_length: float | None = None,
    flat: Path | None = None,
) -> None:
    """Render force and torque for every pose of a trajectory.

    Friction follows from the motion of the trajectory, so the wrenches are those that
    `ttus-opt evaluate` compares, up to the limits. They are written in the frame of
    the recordings, with quaternions w, x, y, z.

    Args:
        output: Trajectory CSV with wrenches.
        force_limit: Limit the magnitude of the force to this, inf for none [N].
        torque_limit: Limit the magnitude of the torque to this, inf for none [N m].
        presliding_length: Let friction hold a probe at rest: it builds up over this
            travel [m], 0 for none; by default the field's.
        flat: Write field, probe and limits here too, as one file that examples/c
            renders without Python.

    Example:
        ttus-opt render --field field.nc --probe ellipsoid:0.030,0.0125,0.018
        --trajectory poses.csv -o rendered.csv
    """
    import numpy as np

    from ttus_opt.contact.friction import FRICTION, PRESLIDING
    from ttus_opt.contact.scene_warnings import cut_off
    from ttus_opt.core.errors import warn
    from ttus_opt.haptic.renderer import Renderer
    from ttus_opt.voxmap.field import PotentialField

    conventions = recordings.conventions
    with Stages(3) as begin:
        begin("reading field and poses")
        as_written = recordings.as_written()
        potential = PotentialField.load(field)
        if presliding_length is not None:
            given = {PRESLIDING: presliding_length}
            potential = replace(potential, parameters={**potential.parameters, **given})
            if presliding_length > 0.0 and not potential.parameters.get(FRICTION):
                warn(f"{field} has no friction: its presliding length has no effect")
        shell = probe_for(potential.provenance, probe, recordings)
        poses = recordings.read(as_written, shell, potential.voxmap.surface)
        begin("rendering")
        renderer = Renderer(
            potential, shell, force_limit=force_limit, torque_limit=torque_limit
        )
        frames = list(zip(poses.rotation, poses.position, poses.twist(), strict=True))
        start = time.perf_counter()
        wrenches = [renderer.render(*frame) for frame in frames]
        seconds = time.perf_counter() - start
        warn_of_poses(
            np.array([w.in_grid for w in wrenches]),
            np.array([w.beyond_inner for w in wrenches]),
            cut_off(potential.voxmap, shell, poses.rotation, poses.position),
        )
        begin("writing")
        rendered = replace(
            poses,
            force=np.array([w.force for w in wrenches]),
            torque=np.array([w.torque for w in wrenches]),
        )
        if flat is not None:
            from ttus_opt.haptic.flat_file import write_flat

            limits = {"force_limit": force_limit, "torque_limit": torque_limit}
            write_flat(flat, potential, shell, **limits)
        place = potential.voxmap.surface.axis.scan_to_patient
        conventions.as_recorded(rendered, shell.reference, place).save(output)
    facts = {
        "output": str(output),
        "flat": None if flat is None else str(flat),
        "frames": len(poses),
        "frames_touching": sum(w.contact_points > 0 for w in wrenches),
        "frames_beyond_inner": sum(w.beyond_inner > 0 for w in wrenches),
        "frames_saturated": sum(w.saturated for w in wrenches),
        "seconds_per_frame": seconds / len(poses),
    }
    line = (
        f"{output}: {facts['frames']} frames, {facts['frames_touching']} touching, "
        + (
            f"{cut} scaled down to a limit, "
            if (cut := facts["frames_saturated"])
            else ""
        )
        + f"{1e6 * seconds / len(poses):.0f} µs per frame"
    )
    flat_line = [] if flat is None else [f"{flat}: field and probe for examples/c"]
    tell(facts, line, *flat_line)
