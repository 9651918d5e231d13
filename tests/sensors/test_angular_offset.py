"""Angular speeds of exact and of noisy poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, RotationSpline

from tests.kit import InputError, refuses, some
from tests.sensors.test_clock import wander
from ttus_opt.probe.trajectory import Trajectory, read_trajectory
from ttus_opt.sensors.angular_offset import angular_offset
from ttus_opt.sensors.clock import Signal, clock_offset
from ttus_opt.sensors.streams import poses_at


def test_angular_speed_is_that_of_any_frame():
    time = np.arange(0, 20, 0.02)
    turns = Rotation.from_rotvec(np.outer(0.3 * wander(time), [0.2, 0.9, 0.3]))
    poses = Trajectory(time, np.zeros((len(time), 3)), turns.as_matrix())
    base = Rotation.from_rotvec([1.0, 2.0, -0.4]).as_matrix()
    tool = Rotation.from_rotvec([-0.3, 0.1, 1.4]).as_matrix()
    later = np.arange(2.0, 17.0, 0.05)
    moved = poses_at(poses, later, largest_gap=1.0)
    second = Trajectory(later - 0.8, moved.position, base @ moved.rotation @ tool)
    found = angular_offset(poses, second)
    assert found.seconds == pytest.approx(0.8, abs=0.02)


def tracked(shared, run, noise, offset, rng):
    """A robot's own poses, 20 Hz, and a tracker's with jitter, quantised, 30 Hz."""
    robot = read_trajectory(shared / "wrench" / f"{run}.csv")
    turns = RotationSpline(robot.time, Rotation.from_matrix(robot.rotation))
    stamp = np.arange(robot.time[0] + 0.3, robot.time[-1] - 0.3, 1 / 30)
    seen = turns(stamp + rng.normal(0.0, 2e-3, len(stamp)))
    errors = rng.normal(0.0, np.deg2rad(noise), (len(stamp), 3))
    quaternion = (seen * Rotation.from_rotvec(errors)).as_quat()
    rotation = Rotation.from_quat(np.round(quaternion, 3)).as_matrix()
    return robot, Trajectory(stamp - offset, np.zeros((len(stamp), 3)), rotation)


RUNS = ("run_A_20_17_35_10", "run_B_20_16_44_10")


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", some(zip(RUNS * 2, (0.5, 0.2, 0.2, 0.5), strict=True), 1)
)
def test_the_offset_of_noisy_poses_is_without_bias(shared, case):
    """Differences of the same poses are refused; the stated error holds the bias."""
    run, noise = case
    rng = np.random.default_rng(0)
    errors, stated = [], []
    for offset in rng.uniform(-0.3, 0.3, 6):
        pair = tracked(shared, run, noise, offset, rng)
        found = angular_offset(*pair)
        assert found.correlation > 0.95
        errors.append(found.seconds - offset)
        stated.append(found.std)
    assert abs(np.mean(errors)) < np.median(stated)
    assert np.median(stated) < 0.03  # twice the scatter at most
    if noise == 0.5 and run.startswith("run_A"):
        raw = [
            Signal(poses.time, np.linalg.norm(poses.angular_velocity(), axis=1))
            for poses in pair
        ]
        refuses(InputError, "correlate by", clock_offset, *raw)
