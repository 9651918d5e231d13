"""``ttus-opt compensate``: contact wrenches from raw readings of a force sensor."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ttus_opt.cli.console import tell
from ttus_opt.cli.options import numbers
from ttus_opt.cli.recording_options import ProbeOptions


def compensate(
    recording: Annotated[Path, typer.Argument()],
    free: Path,
    down: str,
    axes: str,
    point: str,
    sign: str,
    probe: ProbeOptions,
    output: Path,
    model: Path | None = None,
    inertia: bool = False,
    stream: str | None = None,
    columns: Annotated[str, typer.Option(metavar="NAME=COLUMN,…|FILE")] = "",
    repair: bool = False,
) -> None:
    """Remove bias, weight and inertia from the readings of a force sensor.

    You state the sensor's axes, reference point and sign; the free poses check the axes
    and the sign. The output has the force on the probe and the torque about the point
    shell's reference point, in the axes of the poses' frame.

    Args:
        recording: Poses with raw readings in the sensor's axes.
        free: The same with raw readings of the probe tilted in free air.
        down: Direction of gravity in the frame of the poses, x,y,z.
        axes: The sensor's axes in the probe frame, quaternion x,y,z,w.
        point: Point about which torques are measured, in the probe frame, x,y,z [m].
        sign: on-probe: the readings are the force on the probe; by-probe: the force it
            exerts.
        output: Trajectory CSV with contact wrenches.
        model: Write the statements, bias, mass and centre of mass here (JSON).
        inertia: Subtract the load's inertia too.
        stream: Name of the topic, transform, tool or body, if a file has several.
        columns: Column names of both files, or a YAML file of them.

    Example:
        ttus-opt compensate press_raw.csv --free free.csv --down 0,0,-1 --axes 0,0,0,1
        --point 0,0,0.08 --sign on-probe --probe ellipsoid:0.030,0.0125,0.018 -o
        press.csv
    """
    import numpy as np

    from ttus_opt.core import io
    from ttus_opt.probe.pose import from_quaternions
    from ttus_opt.sensors.column_map import read_column_map
    from ttus_opt.sensors.force_sensor import ForceSensor
    from ttus_opt.sensors.stream_files import read_recording
    from ttus_opt.sensors.tool_load import identify_load
    from ttus_opt.sensors.wrench_compensation import compensated

    sensor = ForceSensor(
        from_quaternions(np.array([numbers(axes, 4, "--axes")]), "xyzw")[0],
        np.array(numbers(point, 3, "--point")),
        sign,  # type: ignore[arg-type]  # checked there
    )
    direction = numbers(down, 3, "--down")
    how = stream, read_column_map(columns)
    raw = read_recording(recording, *how, repair=repair)
    still = read_recording(free, *how, repair=repair)
    reference = probe.read().reference
    load = identify_load(still, sensor, direction)
    clean = compensated(raw, sensor, load, direction, reference, inertia=inertia)
    facts = {
        "output": str(output),
        "frames": len(clean),
        "sensor": sensor.statements(),
        "down": list(direction),
        "inertia": inertia,
        "torque_about": reference.tolist(),
        **load.facts(),
    }
    clean.save(output)
    if model is not None:
        io.write_text(model, json.dumps(facts, indent=2) + "\n")
    lines = [f"{output}: {len(clean)} frames; load {load}"]
    if not load.handedness_told:
        lines.append("the free poses cannot reveal a left-handed sensor")
    tell(facts, *lines)
