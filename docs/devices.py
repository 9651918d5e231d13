"""Writes docs/how-to/devices-to-field.md: from three devices' files to a field.

A RealSense, an NDI tracker and an ATI force sensor see the bundled example's torso and
presses, each in its own frame, unit and clock, with holes; their files are written in
the makers' layouts by the makers of the tests' samples. Every command after the first
follows from what the one before said: the words that mend are read from its output. The
script ends with an error when a command says something else, or when the unseen force
error is not below `GOAL`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

from first_hour import (  # noqa: E402  beside this file
    Terminal,
    mended,
    unseen_error,
    write_page,
    write_probe,
)

from tests.sensors.test_depth_bag import Camera, recorded  # noqa: E402
from tests.sensors.test_stream_formats import (  # noqa: E402
    Felt,
    Motion,
    ati,
    ndi_toolbox,
)
from ttus_opt import example  # noqa: E402
from ttus_opt.phantom.camera import ScanSetup, View, depth_image  # noqa: E402
from ttus_opt.phantom.example_data import TORSO  # noqa: E402
from ttus_opt.probe.rigid_motion import homogeneous, inverse  # noqa: E402
from ttus_opt.probe.trajectory import Trajectory, read_trajectory  # noqa: E402
from ttus_opt.session.synthetic import Truth, at_times, shaken  # noqa: E402

PAGE = Path(__file__).parent / "how-to" / "devices-to-field.md"

#: Largest mean force error on recordings that were not fitted [N]
GOAL = 0.3

#: A camera over the belly, 320 x 320 pixels, whose unit is 0.1 mm
VIEW = View((0.0, 0.95, 0.15), opening=0.32, pixels=320)
UNIT = 1e-4

#: Rates of the tracker, of the force sensor and of the tag in the camera [Hz]
TRACKED, FELT, TAGGED = 60, 250, 30

#: The sensor's reference point, frame of the probe [m]
POINT = np.array([0.0, 0.0, -0.08])

HEAD = """# From three devices to a field

A RealSense looks at the patient, an NDI tracker follows the probe, and an ATI force
sensor behind the probe reads forces, each in its own frame, unit and clock, and with
holes: a hand before the tracker, lost packets, a packet that came twice, a line cut off
by the end. The files are

- `scan.bag` of the RealSense's SDK;
- `tracker.csv` and `force.csv` to fit, `tracker_2.csv` and `force_2.csv` to evaluate:
  exports of NDI ToolBox, logs of the Net F/T's demo program, set to zero in the air
  (of a heavy probe [subtract the weight](force-sensor.md) first);
- `waved.csv` and `tag.csv`: the probe waved for half a minute, seen by the tracker and,
  by a tag on the probe, by the camera;
- `probe.stl`, from CAD, in whose frame the tracker's tool was defined. The force sensor
  has the same axes.

They are made from the bundled example in the makers' documented layouts. Where a
command is typed again, the new options are those that it named. Output is what the
terminal shows, with times left out.

(`docs/devices.py` writes this page and fails when a command does not say what to do
next; a slow test does the same.)"""


@dataclass(frozen=True)
class Press:
    """One pair of files of tracker and force sensor.

    Attributes:
        names: Recordings of the example that it has.
        ending: Of the files' names.
        clocks: Tracker's clock at the first pose; the force sensor's switching on [s].
        hidden: First frame and number of frames that the tracker does not see.
    """

    names: Sequence[str]
    ending: str
    clocks: tuple[float, float]
    hidden: Sequence[tuple[int, int]]


PRESSES = (
    Press(
        ("press_fit", "sweep_fit"),
        "",
        (1000.0, 2.3),
        ((200, 12), (700, 30), (1500, 60), (1900, 20), (2200, 40)),
    ),
    Press(("press_test", "sweep_test"), "_2", (1180.0, 0.9), ((400, 25), (1600, 15))),
)


def camera_pose() -> np.ndarray:
    """Camera to the example's patient frame, (4, 4): x right, y down, z ahead."""
    right, up, ahead = VIEW.axes()
    return homogeneous(np.stack([right, -up, ahead], axis=1), np.array(VIEW.eye))


def write_scan(rng: np.random.Generator) -> None:
    """Five depth images of a body on a table, noise of 2 mm, holes."""
    images = [depth_image(ScanSetup(TORSO), VIEW, rng) for _ in range(5)]
    whole = [np.nan_to_num(np.round(d / UNIT)).astype(np.uint16) for d in images]
    centre = (VIEW.pixels - 1) / 2
    focal = centre / np.tan(VIEW.opening)
    K = (focal, 0.0, centre, 0.0, focal, centre, 0.0, 0.0, 1.0)
    recorded(Path("scan.bag"), camera=Camera(whole, K, UNIT))


def write_presses(press: Press, rng: np.random.Generator) -> None:
    """Pushes and sweeps as tracker and force sensor record them."""
    parts = [read_trajectory(example.path(f"{name}.csv")) for name in press.names]
    parts[1] = replace(parts[1], time=parts[1].time + parts[0].time[-1] + 2.0)
    both = Trajectory.concatenate(parts)
    end = both.time[-1]
    seen = at_times(both, np.arange(0.0, end, 1.0 / TRACKED))
    probe = homogeneous(seen.rotation, seen.position)
    in_tracker = inverse(Truth().tracker_to_scan) @ inverse(camera_pose()) @ probe
    hidden = [f for begin, n in press.hidden for f in range(begin, begin + n)]
    _save_tracked(
        Path(f"tracker{press.ending}.csv"),
        seen.time + press.clocks[0],
        shaken(in_tracker, 2e-4, np.radians(0.05), rng),
        hidden,
    )
    read = at_times(both, np.arange(press.clocks[1], end, 1.0 / FELT))
    own = read.rotation.transpose(0, 2, 1)  # axes of the probe
    assert read.force is not None and read.torque is not None
    force = np.einsum("tij,tj->ti", own, read.force)
    torque = np.einsum("tij,tj->ti", own, read.torque)
    torque -= np.cross(POINT, force)
    noise = rng.normal(size=(2, len(force), 3))
    force, torque = -force + 0.02 * noise[0], -torque + 0.001 * noise[1]
    lost = {*rng.integers(len(force), size=40).tolist(), *range(3000, 3040)}
    file = Path(f"force{press.ending}.csv")
    ati(file, True, Felt(FELT, force, torque, lost, range(5000, 5060)))
    text = file.read_text().splitlines()
    # a packet that came twice, and a line cut off by the end
    file.write_text("\n".join([*text[:900], text[899], *text[900:]])[:-20])


def _save_tracked(
    file: Path, time: np.ndarray, poses: np.ndarray, hidden: Sequence[int] = ()
) -> None:
    turns = Rotation.from_matrix(poses[:, :3, :3])
    ndi_toolbox(file, Motion(time, poses[:, :3, 3], turns, set(hidden)))


def write_waving(rng: np.random.Generator) -> None:
    """The probe waved before tracker and camera, which sees a tag on it."""
    time = np.arange(0.0, 30.0, 1.0 / TRACKED)
    speeds = rng.uniform(0.6, 4.0, (3, 3))  # three sines an axis [rad/s]
    waves = np.sin(time[:, None, None] * speeds + rng.uniform(0.0, 6.0, (3, 3)))
    turns = Rotation.from_rotvec(0.35 * waves.sum(axis=2)).as_matrix()
    probe = homogeneous(turns, 0.05 * waves[:, ::-1].sum(axis=2) + [0.0, 0.0, 0.6])
    truth = Truth()
    target = shaken(inverse(truth.tracker_to_scan) @ probe, 2e-4, 1e-3, rng)
    _save_tracked(Path("waved.csv"), time + 900.0, target)
    tag = shaken(probe @ inverse(truth.tag_to_target), 5e-4, 3e-3, rng)
    some = slice(20, None, TRACKED // TAGGED)
    tagged = Trajectory(time[some], tag[some, :3, 3].copy(), tag[some, :3, :3].copy())
    tagged.save("tag.csv")


def transcript() -> list[str]:
    """Run it in the present folder; the page's lines.

    Raises:
        SystemExit: A command did not say what to do, or the goal is missed.
    """
    terminal, rng = Terminal(), np.random.default_rng(3)
    write_scan(rng)
    for press in PRESSES:
        write_presses(press, rng)
    write_waving(rng)
    write_probe()
    terminal.tell("## What the files hold")
    terminal.run("ttus-opt doctor scan.bag tracker.csv force.csv", statuses=(1,))
    terminal.tell("## The surface")
    terminal.run("ttus-opt surface scan.bag -o surface.nc")
    terminal.tell("## Where the tracker is")
    find = (
        "ttus-opt hand-eye waved.csv tag.csv --camera fixed -o tracker_to_camera.json"
    )
    for mend in (r"for instance (--stream Probe)", r"give (--together)"):
        find += f" {mended(terminal.run(find, statuses=(2,)), mend)}"
    terminal.run(find)
    terminal.tell("## Poses and forces on one clock")
    join = "ttus-opt synchronise tracker.csv --wrenches force.csv --by contact"
    join += " -o press.csv"
    mends = (
        r"needs (--surface)",
        r"for instance (--stream Probe)",
        r"read it with (--repair)",
        r"give (--together)",
        r"or (--base-to-scan) for a robot's or tracker's",
    )
    given = {"--surface": " surface.nc", "--base-to-scan": " tracker_to_camera.json"}
    for mend in mends:
        option = mended(terminal.run(join, statuses=(2,)), mend)
        join += f" {option}{given.get(option, '')}"
    terminal.run(join)
    terminal.tell("## The field")
    fit = "ttus-opt fit --surface surface.nc --probe probe.stl --trajectory press.csv"
    fit += " --shape 40,96,48 -o field.nc"
    option = mended(
        terminal.run(fit, statuses=(2,)), r"or (--base-to-scan) for a robot's"
    )
    base = f"{option} tracker_to_camera.json"
    written = ""
    while "read them with" in (said := terminal.run(f"{fit} {base} {written}".strip())):
        value = r"(?: (?!--)\S+(?<!:)(?!\S))?"  # of an option
        told = mended(said, rf"read them with ((?:--[a-z-]+{value} ?)+)")
        told = " ".join(told.replace("--base-to-scan …", "").split())
        if told == written:
            raise SystemExit(f"still in doubt:\n{said}")
        written = told
    terminal.tell("## Unseen recordings")
    for old, new in (
        ("tracker", "tracker_2"),
        ("force", "force_2"),
        ("press", "other"),
    ):
        join = join.replace(f"{old}.csv", f"{new}.csv")
    search = mended(
        terminal.run(join, statuses=(2,)), r"less far than (--largest-offset) 5"
    )
    terminal.tell("Both were begun within two seconds:")
    terminal.run(f"{join} {search} 2")
    evaluate = "ttus-opt evaluate --field field.nc --probe probe.stl --trajectory "
    evaluate += f"other.csv {base} {written}"
    error = unseen_error(terminal, evaluate, GOAL)
    terminal.tell(
        f"The mean force error is {error:.2f} N on recordings that had no part in the "
        "fit."
    )
    return terminal.lines


if __name__ == "__main__":
    write_page(PAGE, HEAD, transcript)
