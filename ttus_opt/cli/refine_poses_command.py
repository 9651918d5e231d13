"""``ttus-opt refine-poses``: errors of tracked poses, estimated from the forces."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.cli.console import Stages, tell
from ttus_opt.cli.recording_options import ProbeOptions, RecordingOptions
from ttus_opt.cli.scene_building import measured
from ttus_opt.cli.scene_options import SceneOptions
from ttus_opt.core.errors import counted

if TYPE_CHECKING:
    from ttus_opt.core.arrays import Array
    from ttus_opt.fitting.poses.pose_refinement import RefinedPoses


def refine_poses(
    surface: Path,
    probe: ProbeOptions,
    recordings: RecordingOptions,
    grid: SceneOptions,
    output: Path,
    position_noise: float = 0.5,
    rotation_noise: float = 0.5,
    correlation: float = 1.0,
) -> None:
    """Take the tracker's errors off recorded poses, as far as the forces tell them.

    The output holds all recordings, in the patient's frame, for ttus-opt fit. Refine
    only what is fitted: judge a field at poses as they were reported.

    Args:
        output: Trajectory CSV.
        position_noise: Standard deviation of a tracked position, per axis [mm].
        rotation_noise: Standard deviation of a tracked rotation, per axis [°].
        correlation: Time over which these errors stay alike [s].

    Example:
        ttus-opt refine-poses --surface surface.nc --probe ellipsoid:0.030,0.0125,0.018
        --trajectory press.csv --trajectory sweep.csv -o refined.csv
    """
    from ttus_opt.fitting.checks.zero_check import warn_of_zero
    from ttus_opt.fitting.poses import pose_refinement
    from ttus_opt.probe.tracker_noise import TrackerNoise

    size = 1e-3 * position_noise, math.radians(rotation_noise)
    noise, plan = TrackerNoise(*size, correlation), grid.plan
    with Stages(2 + pose_refinement.MOST_STEPS) as begin:
        scene = measured(surface, probe, recordings, plan, begin).scene
        warn_of_zero(scene)
        found = pose_refinement.refine_poses(
            scene, noise, progress=lambda: begin("refining")
        )
    found.trajectory.save(output)
    tell(_summary(found, output), *_lines(found, output))


def _summary(found: RefinedPoses, output: Path) -> dict[str, Any]:
    return {
        "output": str(output),
        "frames": len(found.trajectory),
        "recordings": [_figures(found, own) for own in found.trajectory.parts],
        "log_evidence_gain": found.gain,
        "steps": found.steps,
        "held_out": None if found.check is None else found.check._asdict(),
    }


def _figures(found: RefinedPoses, own: slice) -> dict[str, float]:
    """Root mean squares of a recording, of a component."""
    errors, std = found.errors[own], found.std[own]
    return {
        "position_mm": 1e3 * _rms(errors[:, :3]),
        "position_std_mm": 1e3 * _rms(std[:, :3]),
        "rotation_deg": math.degrees(_rms(errors[:, 3:])),
        "rotation_std_deg": math.degrees(_rms(std[:, 3:])),
    }


def _rms(values: Array) -> float:
    return math.sqrt((values**2).mean())


def _lines(found: RefinedPoses, output: Path) -> list[str]:
    lines = []
    for number, own in enumerate(found.trajectory.parts, start=1):
        f = _figures(found, own)
        lines.append(
            f"recording {number}: poses moved by {f['position_mm']:.2f} mm and "
            f"{f['rotation_deg']:.2f}° per axis (rms), which leaves "
            f"{f['position_std_mm']:.2f} mm and {f['rotation_std_deg']:.2f}°"
        )
    lines.append(
        f"{output}: {len(found.trajectory)} frames, {counted(found.steps, 'step')}, "
        f"log evidence {found.gain:+.0f} by the tracker's noise"
    )
    return lines
