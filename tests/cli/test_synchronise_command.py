"""``ttus-opt synchronise``."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.cli.conftest import empty, refused
from tests.kit import torso
from tests.sensors.test_clock import wander
from ttus_opt.probe.trajectory import Trajectory, read_trajectory


@pytest.fixture
def given(tmp_path):
    """A tracker's poses, and a robot's with forces on a clock 0.6 s behind."""
    folder = tmp_path / "given"
    folder.mkdir()
    surface = torso()
    surface.save(folder / "surface.nc")

    def moved(time):
        depth = 0.006 * wander(time)
        angle = np.full_like(time, 1.2)
        r = surface.radius_at(angle, np.full_like(time, 0.1)) - depth
        place = np.stack([r * np.cos(1.2), r * np.sin(1.2), np.full_like(r, 0.1)], 1)
        turns = Rotation.from_rotvec(np.outer(0.2 * wander(time), [0, 1.0, 0]))
        return place, turns.as_matrix(), np.maximum(depth, 0.0)

    time = np.arange(0, 20, 0.04)
    place, turns, _ = moved(time)
    Trajectory(time, place, turns).save(folder / "tracker.csv")
    own = np.arange(0, 19, 0.02)
    place, turns, depth = moved(own + 0.6)
    force = np.outer(900 * depth, [0, 0, 1.0])
    Trajectory(own, place, turns, force, 0 * force).save(folder / "robot.csv")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("by", ["contact", "angular-speed"])
def test_the_offset_is_found(run, given, output, by):
    words = (
        f"synchronise {given / 'tracker.csv'} --wrenches {given / 'robot.csv'} --by "
        f"{by} --surface {given / 'surface.nc'} -o {output / 'both.csv'}"
    )
    told = run(f"{words} --json").told
    assert told["offset_s"] == pytest.approx(0.6, abs=0.04)
    assert told["left_out"] > 0
    joined = read_trajectory(output / "both.csv")
    x, y, _ = joined.position.T
    depth = torso().radius_at(np.full(len(x), 1.2), np.full(len(x), 0.1))
    depth = np.maximum(depth - np.hypot(x, y), 0.0)
    assert np.corrcoef(depth, joined.force[:, 2])[0, 1] > 0.99
    assert "frames in 1 segment," in run(words).out


@pytest.mark.slow
def test_nanoseconds_of_one_clock_and_columns_of_each_file(run, given, output):
    """Forces that begin 2 s after the poses stay there; each file has its own names."""
    robot = read_trajectory(given / "robot.csv")
    late = robot.select(robot.time >= 2.0)
    names = {"tracker": "stamp", "robot": "when"}
    for name, recorded in (("tracker", robot), ("robot", late)):
        recorded.save(given / f"{name}.csv")
        head, *rows = (given / f"{name}.csv").read_text().splitlines()
        cells = [row.split(",", 1) for row in rows]
        rows = [
            f"{1_700_000_000_000_000_000 + int(1e9 * float(t))},{r}" for t, r in cells
        ]
        text = "\n".join([f"{names[name]}{head[1:]}", *rows, ""])
        (given / f"{name}.csv").write_text(text)
    words = (
        f"synchronise {given / 'tracker.csv'} --wrenches {given / 'robot.csv'} "
        f"-o {output / 'both.csv'} --columns t=stamp --wrench-columns t=when"
    )
    for how in ("--offset 0", "--by angular-speed"):
        told = run(f"{words} {how} --json").told
        assert told["offset_s"] == pytest.approx(0.0, abs=2e-3)
        assert told["left_out"] == pytest.approx(len(robot) - len(late), abs=1)
        joined = read_trajectory(output / "both.csv")
        meant = np.interp(joined.time - 1.7e9, late.time, late.force[:, 2])
        np.testing.assert_allclose(joined.force[:, 2], meant, atol=0.05)
    refused(run(words.partition(" --columns")[0] + " --offset 0"), "no column t")


def test_poses_of_a_tracker_on_a_clock_of_its_own(run, given, output):
    """The surface's frame by a motion; what is missing is named, one by one."""
    poses = read_trajectory(given / "tracker.csv")
    turn = Rotation.from_rotvec([0.3, -0.8, 0.5])
    to_patient = np.eye(4)
    to_patient[:3] = np.column_stack([turn.as_matrix(), [0.4, 0.2, -1.0]])
    np.savetxt(given / "motion.txt", to_patient)
    based = poses.transformed(np.linalg.inv(to_patient))
    Trajectory(based.time + 900.0, based.position, based.rotation).save(
        given / "tracker.csv"
    )
    words = (
        f"synchronise {given / 'tracker.csv'} --wrenches {given / 'robot.csv'} --by "
        f"contact -o {output / 'both.csv'}"
    )
    refused(run(words), "--by contact needs --surface")
    words += f" --surface {given / 'surface.nc'}"
    refused(run(words), "--together", "--frame scan", "--base-to-scan")
    refused(run(f"{words} --together --frame scan"), "are --frame and --base-to-scan")
    words += f" --base-to-scan {given / 'motion.txt'}"
    refused(run(words), "--together")
    assert empty(output)
    told = run(f"{words} --together --json").told
    assert told["offset_s"] == pytest.approx(900.6, abs=0.04)
    joined = read_trajectory(output / "both.csv")  # in the tracker's frame, as it was
    near = np.interp(joined.time, based.time + 900.0, based.position[:, 0])
    np.testing.assert_allclose(joined.position[:, 0], near, atol=1e-6)
    refused(run(f"{words} --offset 1".replace("--by contact", "")), "for --by contact")


@pytest.mark.slow
def test_what_is_refused(run, given, output):
    words = (
        f"synchronise {given / 'tracker.csv'} --wrenches {given / 'robot.csv'} "
        f"-o {output / 'both.csv'}"
    )
    refused(run(words), "--by contact", "--offset")
    refused(run(f"{words} --by contact"), "--surface")
    refused(run(f"{words} --by eye"), "contact or angular-speed")
    refused(run(f"{words} --offset 500"), "check the offset")
    refused(run(f"{words} --by angular-speed --largest-offset 0.1"), "correlate by")
    refused(run(f"{words} --offset 0 --largest-gap 0"), "gap")
    robot = read_trajectory(given / "robot.csv")
    replace(robot, torque=np.full_like(robot.force, 1e3)).save(given / "robot.csv")
    told = "robot.csv, frame 0: 1000 N m is not plausible (over 100) (and", "N mm?"
    refused(run(f"{words} --offset 0"), *told)
    assert empty(output)


@pytest.mark.slow
def test_a_ros_recording_for_both(run, tmp_path, output):
    pytest.importorskip("rosbags", reason="needs ttus-opt[sensors]")
    from tests.sensors.test_ros_bag import recorded

    bag = recorded(tmp_path, "ros1")
    words = f"synchronise {bag} --wrenches {bag} --offset 0 -o {output / 'r.csv'}"
    refused(run(words), "several topics", "/posestamped")
    answer = run(f"{words} --pose-topic /posestamped")
    assert "10 of 10 frames" in answer.out
    assert read_trajectory(output / "r.csv").has_torque
