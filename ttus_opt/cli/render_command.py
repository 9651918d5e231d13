"""``ttus-opt render``: the wrenches a field gives along a trajectory."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ttus_opt.cli.console import Stages, print_json
from ttus_opt.cli.evaluate_command import warn_beyond, warn_off_grid
from ttus_opt.cli.options import (
    Columns,
    Field,
    Force,
    Json,
    Points,
    Probe,
    ProbeSurface,
    ProbeUnit,
    QuaternionOrder,
    TorqueAbout,
    Trajectories,
    check_outputs,
    read_conventions,
    read_probe,
    read_trajectories,
    warn_of_another_probe,
)

EXAMPLE = (
    "ttus-opt render --field field.nc --probe ellipsoid:0.030,0.0125,0.018 "
    "--trajectory poses.csv -o rendered.csv"
)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("render", epilog=f"Example: {EXAMPLE}")(render)


def render(
    field: Field,
    probe: Probe,
    trajectory: Trajectories,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Trajectory CSV with wrenches.")
    ],
    columns: Columns = "",
    quaternion: QuaternionOrder = "wxyz",
    torque_about: TorqueAbout = "centroid",
    points: Points = 1500,
    probe_unit: ProbeUnit = "mm",
    probe_surface: ProbeSurface = "outer",
    force_limit: Annotated[
        float | None, typer.Option(help="Cut larger forces to this [N].")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Render force and torque for every pose of a trajectory.

    A field that was fitted with friction drags as the trajectory's motion tells: the
    wrenches are those that `ttus-opt evaluate` judges.
    """
    import numpy as np

    from ttus_opt.haptic.renderer import Renderer
    from ttus_opt.voxmap.field import PotentialField

    conventions = read_conventions(torque_about, quaternion=quaternion)
    check_outputs([output], [field, probe, *trajectory], force=force)
    with Stages(3) as begin:
        begin("reading field and poses")
        as_written = read_trajectories(trajectory, columns)
        potential = PotentialField.load(field)
        warn_of_another_probe(potential.provenance, probe, conventions)
        shell = read_probe(probe, points, probe_unit, probe_surface)
        poses = conventions.read(as_written, shell.reference)
        begin("rendering")
        renderer = Renderer(potential, shell, force_limit=force_limit)
        frames = list(zip(poses.rotation, poses.position, poses.twist(), strict=True))
        start = time.perf_counter()
        wrenches = [renderer.render(*frame) for frame in frames]
        seconds = time.perf_counter() - start
        warn_off_grid(np.array([w.in_grid for w in wrenches]))
        warn_beyond(np.array([w.beyond_inner for w in wrenches]))
        begin("writing")
        rendered = replace(
            poses,
            force=np.array([w.force for w in wrenches]),
            torque=np.array([w.torque for w in wrenches]),
        )
        conventions.torque_as_recorded(rendered, shell.reference).save(output)
    told = {
        "output": str(output),
        "frames": len(poses),
        "frames_touching": sum(w.contact_points > 0 for w in wrenches),
        "frames_beyond_inner": sum(w.beyond_inner > 0 for w in wrenches),
        "frames_saturated": sum(w.saturated for w in wrenches),
        "seconds_per_frame": seconds / len(poses),
    }
    if json:
        print_json(told)
        return
    typer.echo(
        f"{output}: {told['frames']} frames, {told['frames_touching']} touching, "
        + (f"{told['frames_saturated']} saturated, " if force_limit else "")
        + f"{1e6 * seconds / len(poses):.0f} µs per frame"
    )
