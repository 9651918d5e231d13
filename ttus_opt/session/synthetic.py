"""A synthetic recording for every step of a session, with known ground truth.

The bundled example's torso is scanned, and its four recordings without drag are joined:
the probe is tilted in free air, then presses and sweeps. A tracker beside the bed
reports poses of a target on the probe at 40 Hz; a force sensor with another clock reads
its bias, the weight below it and the contact at 125 Hz. Tracker and scanning camera see
a tag on the target. The stated mounting of the sensor is accurate to half a degree and
a millimetre, like a drawing.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ttus_opt import example
from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError
from ttus_opt.phantom.camera import ScanSetup, View, depth_image
from ttus_opt.phantom.example_data import TORSO, VIEWS, frame
from ttus_opt.probe.pose import to_quaternions
from ttus_opt.probe.rigid_motion import homogeneous, inverse, motion_of
from ttus_opt.probe.trajectory import Trajectory, interpolated, read_trajectory
from ttus_opt.sensors.netcdf_stream import write_netcdf_wrenches
from ttus_opt.sensors.streams import WrenchStream, placed
from ttus_opt.sensors.tool_load import GRAVITY

#: The example's recordings in order, and their use
RECORDINGS = {
    "press_fit": "fit",
    "sweep_fit": "fit",
    "press_test": "test",
    "sweep_test": "test",
}

#: All files of the recording
FILES = (
    "depth_0.png",
    "depth_1.png",
    "camera.json",
    "tracker.csv",
    "force.nc",
    "tags.json",
    "session.json",
)

#: Standard deviation of the depth cameras [m]
DEPTH_NOISE = 0.002

#: Duration of the tilts in free air, and of the pauses between recordings [s]
FREE, PAUSE = 20.0, 3.0

#: Frames per second [Hz]
TRACKER_RATE, SENSOR_RATE = 40.0, 125.0

#: Standard deviations of the tracker, per axis [m, rad]
SHIFT_NOISE, TURN_NOISE = 0.2e-3, np.radians(0.05)

#: Standard deviations of a tag's poses in the scanning camera, and their number
TAG_SHIFT_NOISE, TAG_TURN_NOISE, TAG_POSES = 0.3e-3, np.radians(0.05), 60

#: Standard deviations of the sensor, beside the noise in the example [N, N·m]
FORCE_NOISE, TORQUE_NOISE = 0.02, 0.001

#: Gravity in the patient frame: the patient lies on the back
DOWN = np.array([0.0, -1.0, 0.0])


class Truth(NamedTuple):
    """Ground truth of the calibration.

    Attributes:
        tracker_to_scan: Motion, shape (4, 4).
        tag_to_target: Motion, shape (4, 4).
        target_to_probe: Motion, shape (4, 4); known from the drawing.
        axes: Sensor to probe, shape (3, 3).
        point: The sensor's reference point, probe frame, shape (3,) [m].
        mass: Below the sensor [kg].
        centre: Centre of that mass from the point, sensor axes, shape (3,) [m].
        force_bias: Sensor axes, shape (3,) [N].
        torque_bias: Sensor axes, shape (3,) [N·m].
        offset: Time to add to the sensor's times [s].
    """

    tracker_to_scan: Array = motion_of((0.4, -1.1, 0.7, 1.3, -0.6, 0.4))
    tag_to_target: Array = motion_of((0.2, 0.5, -0.3, 0.03, 0.04, -0.01))
    target_to_probe: Array = motion_of((0.0, 0.8, 0.1, 0.02, -0.05, -0.12))
    axes: Array = Rotation.from_rotvec([0.006, -0.005, 0.785]).as_matrix()
    point: Array = np.array([0.001, 0.0, -0.0805])
    mass: float = 0.38
    centre: Array = np.array([0.003, -0.002, 0.045])
    force_bias: Array = np.array([1.8, -2.6, 4.1])
    torque_bias: Array = np.array([0.03, -0.04, 0.02])
    offset: float = 0.83


#: The stated mounting of the sensor
STATED_AXES = Rotation.from_rotvec([0.0, 0.0, np.pi / 4]).as_quat()
STATED_POINT = (0.0, 0.0, -0.08)


def write_recording(
    folder: str | os.PathLike[str],
    *,
    seconds: float = 20.0,
    shape: tuple[int, int, int] = (48, 120, 60),
) -> Truth:
    """Write the recording and return its ground truth.

    Args:
        folder: Made when missing.
        seconds: Used length of each of the example's recordings, at most 20.
        shape: Voxels of the described fit.

    Raises:
        FileError: The folder holds other files or cannot be written to.
    """
    place, truth = Path(folder), Truth()
    # separate streams: one device's noise does not depend on the others' durations
    tags, scan, tilts, tracker, sensor = np.random.default_rng(0).spawn(5)
    foreign = [f for f in place.glob("*") if f.name not in FILES]
    if foreign:
        raise FileError(
            f"{place} holds other files, for instance {foreign[0].name}: choose an "
            "empty folder"
        )
    io.check_output(place / "session.json")
    moved, stretches = _motion_of_all(seconds, tilts)
    images = {f"depth_{i}.png": view for i, view in enumerate(VIEWS)}
    cameras = write_depth(place, images, scan)
    _tracked(moved, truth, tracker).save(place / "tracker.csv", digits=9)
    times = np.arange(0.0, moved.time[-1], 1.0 / SENSOR_RATE)
    write_netcdf_wrenches(sensed(moved, times, truth, sensor), place / "force.nc")
    _write_json(place / "tags.json", _tag_pairs(truth, tags))
    description = _description(truth, stretches, shape, cameras)
    _write_json(place / "session.json", description)  # last: the folder is whole
    return truth


def perfect(seconds: float = 20.0) -> dict[str, Trajectory]:
    """All recordings without errors, frame of the example's surface."""
    return {name: recording(name, seconds) for name in RECORDINGS}


def recording(name: str, seconds: float) -> Trajectory:
    """One of `RECORDINGS` without errors, frame of the example's surface."""
    whole = read_trajectory(example.path(f"{name}.csv"))
    return whole.select(whole.time <= seconds)


def _motion_of_all(
    seconds: float, rng: np.random.Generator
) -> tuple[Trajectory, dict[str, tuple[float, float]]]:
    """The probe's whole trajectory, patient frame, and the times of each recording."""
    parts, begin = [tilts(rng)], FREE + PAUSE
    stretches = {}
    for name in RECORDINGS:
        motion = recording(name, seconds)
        length = float(motion.time[-1])
        stretches[name] = (begin, begin + length)
        parts.append(replace(motion, time=motion.time + begin))
        begin += length + PAUSE
    return Trajectory.concatenate(parts), stretches


def tilts(rng: np.random.Generator) -> Trajectory:
    """A probe held 15 cm above the belly, tilted anew every second."""
    held = np.arange(0.0, FREE + 0.5, 1.0)
    # the probe's z into the skin
    towards = Rotation.from_euler("x", 90.0, degrees=True)
    tilts = Rotation.from_rotvec(rng.normal(0.0, 0.5, (len(held), 3))) * towards
    # at rest for half of every second
    stops = np.sort(np.concatenate([held, held[:-1] + 0.5]))
    turns = Slerp(stops, tilts[np.arange(len(stops)) // 2])
    time = np.arange(0.0, FREE, 0.05)
    place = np.tile([0.0, 0.27, 0.15], (len(time), 1))
    place += 0.02 * np.sin(np.outer(time, [0.9, 0.7, 0.5]))
    none = np.zeros((len(time), 3))
    return Trajectory(time, place, turns(time).as_matrix(), none, none)


def at_times(moved: Trajectory, time: Array) -> Trajectory:
    """Pose and contact at other times, by slerp and linear interpolation."""
    assert moved.force is not None
    assert moved.torque is not None
    rotation, position = placed(moved, time)
    force, torque = (
        interpolated(time, moved.time, values) for values in (moved.force, moved.torque)
    )
    return Trajectory(time, position, rotation, force, torque)


def _patient_to_scan() -> Array:
    return inverse(frame().scan_to_patient)


def shaken(
    motions: Array, shift: float, turn: float, rng: np.random.Generator
) -> Array:
    """Motions with noise, shape (T, 4, 4)."""
    out = motions.copy()
    small = Rotation.from_rotvec(rng.normal(0.0, turn, (len(out), 3))).as_matrix()
    out[:, :3, :3] = small @ out[:, :3, :3]
    out[:, :3, 3] += rng.normal(0.0, shift, (len(out), 3))
    return out


def _targets(moved: Trajectory, truth: Truth) -> Array:
    """Target to tracker, shape (T, 4, 4)."""
    to_tracker = inverse(truth.tracker_to_scan) @ _patient_to_scan()
    probe = homogeneous(moved.rotation, moved.position)
    return np.asarray(to_tracker @ probe @ truth.target_to_probe)


def _tracked(moved: Trajectory, truth: Truth, rng: np.random.Generator) -> Trajectory:
    """The tracker's poses; the target is hidden in the pauses between recordings."""
    time = np.arange(0.0, moved.time[-1], 1.0 / TRACKER_RATE)
    hidden = np.zeros(len(time), dtype=bool)
    gaps = np.flatnonzero(np.diff(moved.time) > 0.5 * PAUSE)
    for begin in moved.time[gaps]:
        hidden |= (time > begin + 0.5) & (time < begin + PAUSE - 0.5)
    seen = at_times(moved, time[~hidden])
    target = shaken(_targets(seen, truth), SHIFT_NOISE, TURN_NOISE, rng)
    return Trajectory(seen.time, target[:, :3, 3].copy(), target[:, :3, :3].copy())


def sensed(
    moved: Trajectory, time: Array, truth: Truth, rng: np.random.Generator
) -> WrenchStream:
    """The force sensor's readings at times of the poses, on its own clock."""
    here = at_times(moved, time)
    assert here.force is not None
    assert here.torque is not None
    shell_centre = np.zeros(3)  # the example's torques are about the probe's centre
    arm = here.rotation @ (shell_centre - truth.point)
    torque = here.torque + np.cross(arm, here.force)
    to_sensor = np.transpose(here.rotation @ truth.axes, (0, 2, 1))
    weight = to_sensor @ (truth.mass * GRAVITY * DOWN)
    own_force = np.einsum("tij,tj->ti", to_sensor, here.force) + weight
    own_torque = np.einsum("tij,tj->ti", to_sensor, torque)
    own_torque += np.cross(truth.centre, weight)
    noise = rng.standard_normal((len(time), 6))
    return WrenchStream(
        time - truth.offset,
        own_force + truth.force_bias + FORCE_NOISE * noise[:, :3],
        own_torque + truth.torque_bias + TORQUE_NOISE * noise[:, 3:],
    )


def _tag_pairs(truth: Truth, rng: np.random.Generator) -> list[list[list[list[float]]]]:
    """Poses of the tag in the scan and of the target in the tracker's frame."""
    place = rng.uniform([-0.15, 0.15, 0.0], [0.15, 0.4, 0.3], (TAG_POSES, 3))
    turns = Rotation.from_rotvec(rng.normal(0.0, 0.7, (TAG_POSES, 3))).as_matrix()
    moved = Trajectory(np.arange(float(TAG_POSES)), place, turns)
    target = _targets(moved, truth)
    tag = truth.tracker_to_scan @ target @ truth.tag_to_target
    tag = shaken(tag, TAG_SHIFT_NOISE, TAG_TURN_NOISE, rng)
    target = shaken(target, SHIFT_NOISE, TURN_NOISE, rng)
    return [[a.tolist(), b.tolist()] for a, b in zip(tag, target, strict=True)]


def _description(
    truth: Truth,
    stretches: dict[str, tuple[float, float]],
    shape: tuple[int, int, int],
    cameras: list[list[list[float]]],
) -> dict[str, object]:
    down = _patient_to_scan()[:3, :3] @ DOWN
    to_target = inverse(truth.target_to_probe)
    quaternion = to_quaternions(to_target[None, :3, :3])[0]
    return {
        "title": "Synthetic recording",
        "probe": example.PROBE,
        "scan": {
            "depth": [f"depth_{i}.png" for i in range(len(cameras))],
            "intrinsics": "camera.json",
            "camera_to_scan": cameras,
            "noise": f"time-of-flight:{DEPTH_NOISE:g}",
        },
        "tracker": {
            "file": "tracker.csv",
            "tags": "tags.json",
            "probe_to_target": [*to_target[:3, 3], *np.roll(quaternion, -1)],
        },
        "force": {
            "file": "force.nc",
            "sensor": {
                "axes": STATED_AXES.tolist(),
                "point": list(STATED_POINT),
                "sign": "on-probe",
            },
            "down": down.tolist(),
        },
        "clock": {"by": "gravity"},
        "free": {"from": 0.0, "to": FREE - 0.5},
        "recordings": {
            name: {"from": start, "to": end, "use": RECORDINGS[name]}
            for name, (start, end) in stretches.items()
        },
        "fit": {"formulation": "eq10", "shape": list(shape)},
    }


def write_depth(
    folder: Path, views: Mapping[str, View], rng: np.random.Generator
) -> list[list[list[float]]]:
    """Write depth images [mm] by file name and intrinsics; the cameras' poses."""
    import cv2

    poses = []
    for name, view in views.items():
        depth = depth_image(ScanSetup(TORSO), view, rng, noise=DEPTH_NOISE)
        whole = np.nan_to_num(np.round(1e3 * depth), nan=0.0).astype(np.uint16)
        _, content = cv2.imencode(".png", whole)
        with io.replacing(folder / name) as temporary:
            temporary.write_bytes(content.tobytes())
        right, up, ahead = view.axes()
        axes = np.stack([right, -up, ahead], axis=1)  # x right, y down
        pose = homogeneous(axes, view.eye)
        poses.append((_patient_to_scan() @ pose).tolist())
    centre = (view.pixels - 1) / 2  # alike for all
    focal = centre / float(np.tan(view.opening))
    camera = {
        "width": view.pixels,
        "height": view.pixels,
        "K": [focal, 0.0, centre, 0.0, focal, centre, 0.0, 0.0, 1.0],
        "D": [],
    }
    _write_json(folder / "camera.json", camera)
    return poses


def _write_json(path: Path, content: object) -> None:
    io.write_text(path, json.dumps(content, indent=2) + "\n")
