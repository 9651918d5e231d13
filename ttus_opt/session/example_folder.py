"""A folder to try the commands in: what a laboratory's devices would have written.

The bundled example's torso is scanned and pressed by the bundled recordings. Every file
is in the frame and unit that its device would use: scan and probe in millimetres,
recordings in the patient frame that ``ttus-opt surface`` finds in the scan, raw forces
with bias and weight, a robot in its own base. The same files come out every time.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt import example
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError
from ttus_opt.phantom.camera import ScanSetup, View, scan, write_cloud
from ttus_opt.phantom.example_data import PROBE, TORSO, VIEWS, frame
from ttus_opt.probe.rigid_motion import homogeneous, inverse, motion_of
from ttus_opt.probe.trajectory import Trajectory, read_trajectory
from ttus_opt.scan.cloud import read_cloud
from ttus_opt.scan.frame import Axis
from ttus_opt.sensors.streams import WrenchStream, poses_at
from ttus_opt.session.synthetic import (
    Truth,
    at_times,
    sensed,
    shaken,
    tilts,
    write_depth,
    write_recording,
)

#: The folder's files, with what each is, in the order of the work
FILES = {
    "scan.ply": "cloud of a torso on a table, scan frame [mm]",
    "probe.stl": "the probe, an ellipsoid of 60 x 25 x 36 mm [mm]",
    "press.csv": "pushes with lift-offs, patient frame",
    "sweep.csv": "lines along the body, patient frame",
    "other.csv": "other pushes, to judge by, patient frame",
    "poses.csv": "poses alone, to render at, patient frame",
    "room.xyz": "the scan with floor and wall around it [mm]",
    "later.ply": "a later scan by one camera, same frame [mm]",
    "probe_pose.csv": "the probe held above the sternum, scan frame",
    "left.png": "depth image of the torso, 96 x 96 pixels [mm]",
    "right.png": "the same from the other side",
    "front.png": "the same from above the feet",
    "camera.json": "intrinsics of all three",
    "cameras.csv": "their poses in this order, scan frame",
    "tracker.csv": "poses of the pushes at 40 Hz, patient frame",
    "force.csv": "their contact forces at 125 Hz, on another clock",
    "press_raw.csv": "the pushes with a force sensor's raw readings",
    "free.csv": "the same sensor, tilted in free air",
    "robot.csv": "the pushes in a robot's base, wrenches in the tool's axes",
    "base_to_scan.txt": "from the robot's base to the scan frame, 4 x 4",
    "camera_poses.csv": "a marker on a hand that is waved, seen by a camera",
    "robot_poses.csv": "the same hand in its robot's base, on another clock",
    "photo.png": "a photo of a board of markers and of a tag",
    "photo.json": "intrinsics of its camera",
    "recording": "a whole recording: depth images, tracker, raw forces, tags",
    "commands.sh": "the README's commands on these files",
}

COMMANDS = """\
ttus-opt surface scan.ply --unit mm -o surface.nc --picture surface.png
ttus-opt fit --surface surface.nc --probe probe.stl --probe-unit mm --trajectory press.csv -o field.nc
ttus-opt path --surface surface.nc --probe probe.stl --trajectory press.csv --held-out other.csv \\
              --weight force,torque=1e-4:1e2:25 -o path.nc --picture path.png
ttus-opt evaluate --field field.nc --probe probe.stl --trajectory other.csv --picture force.png
ttus-opt render --field field.nc --probe probe.stl --trajectory poses.csv -o rendered.csv
"""  # noqa: E501  as the README has them

#: Clock of ``force.csv`` and of the robot behind those of the poses [s]
FORCE_OFFSET, ROBOT_OFFSET = 0.37, 0.75

#: A camera above the patient's feet
FRONT = View((0.0, 0.8, -0.35), opening=0.30, pixels=96)

#: Digits of numbers in recordings [–]
DIGITS = 8


def write_folder(folder: str | os.PathLike[str], *, force: bool = False) -> Path:
    """Write the folder, whole or not at all.

    Args:
        folder: Made when missing.
        force: Replace files of the same names.

    Returns:
        The folder.

    Raises:
        FileError: It has a file of such a name already, or cannot be written to.
    """
    place = Path(folder)
    there = [name for name in FILES if (place / name).exists()]
    if there and not force:
        raise FileError(
            f"{place} has {there[0]} already: choose another folder, or pass force=True"
        )
    try:
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place, prefix=".example-") as made:
            _write(Path(made))
            for name in FILES:
                if (place / name).is_dir():
                    shutil.rmtree(place / name)
                os.replace(Path(made) / name, place / name)
    except OSError as error:
        raise FileError(f"cannot write the example into {place}: {error}") from error
    return place


def _write(place: Path) -> None:
    rng = np.random.default_rng(1).spawn(6)
    _write_scans(place, rng[0])
    _write_probe(place / "probe.stl")
    truth = write_recording(place / "recording")
    images = ("left.png", "right.png", "front.png")
    views = dict(zip(images, (*VIEWS, FRONT), strict=True))
    cameras = np.array(write_depth(place, views, rng[5]))
    _save_motions(np.arange(float(len(cameras))), cameras, place / "cameras.csv")
    patient = _Frames(Axis.from_cloud(read_cloud(place / "scan.ply", unit="mm")))
    _write_presses(place, patient)
    _write_clocks(place, patient, rng[1])
    _write_raw(place, patient, truth, rng[2])
    _write_robot(place, patient)
    _write_waving(place, rng[3])
    _write_photo(place, rng[4])
    (place / "commands.sh").write_text(f"set -e\n{COMMANDS}", encoding="utf-8")


@dataclass(frozen=True)
class _Frames:
    """From the bundled recordings' frame to the one found in the scan."""

    axis: Axis

    def recording(self, name: str) -> Trajectory:
        return self.moved(read_trajectory(example.path(f"{name}.csv")))

    def moved(self, own: Trajectory) -> Trajectory:
        to_scan = inverse(frame().scan_to_patient)
        return own.transformed(to_scan, self.axis.scan_to_patient)


def _save(recorded: Trajectory, path: Path) -> None:
    recorded.save(path, digits=DIGITS)


def _save_motions(time: Array, motions: Array, path: Path) -> None:
    """Motions (T, 4, 4) [m] as poses."""
    _save(Trajectory(time, motions[:, :3, 3], motions[:, :3, :3]), path)


def _write_scans(place: Path, rng: np.random.Generator) -> None:
    """The scan, a room around it, and a later scan of the side that one camera sees."""
    cloud = read_cloud(example.path("scan.ply"), unit="m")
    write_cloud(1e3 * cloud, place / "scan.ply")
    span = rng.uniform(-1.5, 1.5, (4000, 2))
    depth = np.full(len(span), 1.4) + rng.normal(0.0, 0.003, len(span))
    floor = np.column_stack([span[:2000], depth[:2000]])  # behind the table
    wall = np.column_stack([span[2000:, 0], depth[2000:], span[2000:, 1] + 0.8])
    room = 1e3 * np.concatenate([cloud, floor, wall])
    np.savetxt(place / "room.xyz", room, fmt="%.1f")
    later = frame().to_scan(scan(ScanSetup(TORSO), VIEWS[:1], rng))
    write_cloud(1e3 * later, place / "later.ply")
    # the probe's z into the patient, its y to the feet
    turn = frame().rotation @ np.array([[-1.0, 0, 0], [0, 0, -1.0], [0, -1.0, 0]])
    above = frame().to_scan(np.array([[0.0, 0.2, 0.2]]))[0]
    held = shaken(np.tile(homogeneous(turn, above), (20, 1, 1)), 2e-4, 1e-3, rng)
    _save_motions(np.linspace(0.0, 0.95, 20), held, place / "probe_pose.csv")


def _write_probe(path: Path) -> None:
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_scale([1e3 * a for a in PROBE.semi_axes])
    mesh.export(path)


def _write_presses(place: Path, patient: _Frames) -> None:
    _save(patient.recording("press_fit"), place / "press.csv")
    _save(patient.recording("sweep_fit"), place / "sweep.csv")
    _save(patient.recording("press_test"), place / "other.csv")
    path = patient.recording("sweep_test")
    _save(replace(path, force=None, torque=None), place / "poses.csv")


def _write_clocks(place: Path, patient: _Frames, rng: np.random.Generator) -> None:
    """Poses and contact forces of the pushes, each at its own rate and clock."""
    pushes = patient.recording("press_fit")
    end = pushes.time[-1]
    tracked = at_times(pushes, np.arange(0.0, end, 1.0 / 40.0))
    _save(replace(tracked, force=None, torque=None), place / "tracker.csv")
    felt = at_times(pushes, np.arange(0.0, end, 1.0 / 125.0))
    assert felt.force is not None
    noise = rng.normal(0.0, 0.02, felt.force.shape)
    WrenchStream(felt.time - FORCE_OFFSET, felt.force + noise, felt.torque).save(
        place / "force.csv"
    )


def _write_raw(
    place: Path, patient: _Frames, truth: Truth, rng: np.random.Generator
) -> None:
    """What the recording's force sensor reads in the pushes and in free air."""
    pushes = read_trajectory(example.path("press_fit.csv"))
    for own, name in ((pushes, "press_raw.csv"), (tilts(rng), "free.csv")):
        read = sensed(own, own.time, truth, rng)
        moved = patient.moved(own)  # readings stay in the sensor's axes
        _save(replace(moved, force=read.force, torque=read.torque), place / name)


def _write_robot(place: Path, patient: _Frames) -> None:
    """The pushes as a robot records them: force of the tool, in its own axes."""
    turn = Rotation.from_euler("xyz", [20.0, -35.0, 140.0], degrees=True).as_matrix()
    base_to_scan = homogeneous(turn, (0.4, -0.7, 0.3))
    np.savetxt(place / "base_to_scan.txt", base_to_scan, fmt="%.9f")
    pushes = patient.recording("press_fit")
    to_scan = inverse(patient.axis.scan_to_patient)
    based = pushes.transformed(to_scan, inverse(base_to_scan))
    assert based.force is not None and based.torque is not None
    in_tool = based.rotation.transpose(0, 2, 1)
    # the probe's centroid is the tool's origin
    own = {
        "force": -np.einsum("tij,tj->ti", in_tool, based.force),
        "torque": -np.einsum("tij,tj->ti", in_tool, based.torque),
    }
    _save(replace(based, **own), place / "robot.csv")


def _write_waving(place: Path, rng: np.random.Generator) -> None:
    """Half a minute of one motion, in a camera and in a robot's base."""
    time = np.arange(0.0, 30.0, 0.01)
    speeds = rng.uniform(0.6, 4.0, (3, 3))  # three sines an axis [rad/s]
    waves = np.sin(time[:, None, None] * speeds + rng.uniform(0.0, 6.0, (3, 3)))
    turns = Rotation.from_rotvec(0.35 * waves.sum(axis=2)).as_matrix()
    shift = 0.05 * waves[:, ::-1].sum(axis=2) + [0.4, 0.1, 0.5]
    hand = homogeneous(turns, shift)
    camera_to_base = motion_of((1.9, -0.6, 0.4, 0.9, -0.5, 1.1))
    marker_to_hand = motion_of((0.3, 0.2, -0.5, 0.03, -0.02, 0.06))
    hand_noisy = shaken(hand, 1e-4, 2e-4, rng)
    _save_motions(time - ROBOT_OFFSET, hand_noisy, place / "robot_poses.csv")
    marker = inverse(camera_to_base) @ hand @ marker_to_hand
    exact = Trajectory(time, marker[:, :3, 3], marker[:, :3, :3])
    seen = poses_at(exact, np.arange(0.5, 29.5, 1.0 / 30.0), largest_gap=0.1)
    noisy = shaken(homogeneous(seen.rotation, seen.position), 5e-4, 3e-3, rng)
    _save_motions(seen.time, noisy, place / "camera_poses.csv")


def _write_photo(place: Path, rng: np.random.Generator) -> None:
    """A board of twelve ArUco markers and an AprilTag beside it, as a camera sees it.

    Markers of 25.6 mm, 6.6 mm apart; the tag has 65 mm.
    """
    import cv2

    scale = 10  # pixels of the drawing a millimetre
    paper = np.full((150 * scale, 220 * scale), 255, np.uint8)
    aruco = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
    board = cv2.aruco.GridBoard((3, 4), 0.0256, 0.0066, aruco)
    across, down = (round(scale * (n * 32.2 - 6.6)) for n in (3, 4))
    paper[100 : 100 + down, 100 : 100 + across] = board.generateImage((across, down))
    tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36H11)
    side = 65 * scale
    tag = cv2.aruco.generateImageMarker(tags, 7, side)
    paper[400 : 400 + side, 1300 : 1300 + side] = tag
    K = np.array([[620.0, 0.0, 319.5], [0.0, 620.0, 239.5], [0.0, 0.0, 1.0]])
    pose = motion_of((0.35, -0.25, 0.1, -0.11, -0.075, 0.42))
    step = 1e-3 / scale
    to_sheet = np.array([[step, 0, step / 2], [0, step, step / 2], [0, 0, 1.0]])
    fine = np.array([[4.0, 0, 1.5], [0, 4.0, 1.5], [0, 0, 1.0]])  # then averaged
    H = fine @ K @ pose[:3, [0, 1, 3]] @ to_sheet
    large = cv2.warpPerspective(paper, H, (2560, 1920), borderValue=120)
    grey = cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA)
    noisy = grey + rng.normal(0.0, 2.0, grey.shape)
    _, content = cv2.imencode(".png", np.clip(noisy, 0, 255).astype(np.uint8))
    (place / "photo.png").write_bytes(content.tobytes())
    camera = {"width": 640, "height": 480, "K": K.ravel().tolist(), "D": [0.0] * 5}
    (place / "photo.json").write_text(json.dumps(camera) + "\n", encoding="utf-8")
