"""A short synthetic recording on a coarse grid, and its description to be spoilt."""

import functools
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.probe.rigid_motion import homogeneous, inverse
from ttus_opt.probe.trajectory import Trajectory, read_trajectory
from ttus_opt.session import synthetic
from ttus_opt.session.synthetic import Truth, write_recording

#: Of each of the example's recordings [s]
SECONDS = 5.0


@functools.cache
def made():
    """The recording, made once for a process."""
    folder = Path(tempfile.mkdtemp(prefix="ttus-session-"))
    write_recording(folder, seconds=SECONDS, shape=(12, 24, 12))
    return folder


def copied(folder):
    """A copy of one's own."""
    return Path(shutil.copytree(made(), folder / "recording"))


def described(recording):
    content: dict[str, Any] = json.loads((recording / "session.json").read_text())
    return content


def rewrite(recording, content):
    (recording / "session.json").write_text(json.dumps(content))


def changed(recording, key, value):
    """Set one value of a description by its dotted key; None takes it out."""
    content = described(recording)
    at = content
    *path, last = key.split(".")
    for name in path:
        at = at.setdefault(name, {})
    if value is None:
        at.pop(last, None)
    else:
        at[last] = value
    rewrite(recording, content)


def calibrated(seconds=20.0, seed=0):
    """The recordings as perfect calibration has them, with the tracker's noise.

    In the frame of the example's surface, at the tracker's times.

    Args:
        seconds: As of `write_recording`.
        seed: The same.
    """
    truth = Truth()
    _, _, tilts, noise, _ = np.random.default_rng(seed).spawn(5)
    moved, stretches = synthetic._motion_of_all(seconds, tilts)
    tracked = synthetic._tracked(moved, truth, noise)
    to_patient = inverse(synthetic._patient_to_scan()) @ truth.tracker_to_scan
    target = homogeneous(tracked.rotation, tracked.position)
    poses = to_patient @ target @ inverse(truth.target_to_probe)
    known = synthetic.at_times(moved, tracked.time)
    seen = Trajectory(
        tracked.time,
        poses[:, :3, 3].copy(),
        poses[:, :3, :3].copy(),
        known.force,
        known.torque,
    )
    return {
        name: seen.select((seen.time >= start) & (seen.time <= end))
        for name, (start, end) in stretches.items()
    }


def begins(recording):
    """When the first stretch to fit to begins [s]."""
    return float(described(recording)["recordings"]["press_fit"]["from"])


def jumped(recording):
    """Let a recording's poses jump by 50 mm, two seconds after its first press."""
    poses = read_trajectory(recording / "tracker.csv")
    late = (poses.time > begins(recording) + 2.0)[:, None]
    position = poses.position + late * [0.05, 0.0, 0.0]
    Trajectory(poses.time, position, poses.rotation).save(recording / "tracker.csv")
