import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import InputError, refuses
from ttus_opt.phantom.example_data import PROBE, poses
from ttus_opt.phantom.press import CoulombDrag
from ttus_opt.phantom.recording import add_noise, add_pose_noise, record
from ttus_opt.probe.tracker_noise import TrackerNoise
from ttus_opt.probe.trajectory import Trajectory, read_trajectory


@pytest.fixture(scope="module")
def smooth(coarse_patch):
    return record(coarse_patch, PROBE, poses("sweep_fit").select(slice(80)))


def test_record_keeps_the_poses_and_pushes_outwards(smooth):
    assert np.array_equal(smooth.position, poses("sweep_fit").position[:80])
    assert (smooth.force[:, 1] > 0.5).all()  # the skin pushes the probe off, +y


def test_drag_opposes_the_motion_within_its_cone(coarse_patch, smooth):
    rough = record(coarse_patch, PROBE, smooth, drag=CoulombDrag(0.25))
    drag = rough.force - smooth.force
    velocity = smooth.velocity()
    moving = np.linalg.norm(velocity, axis=1) > 2e-3
    assert (np.einsum("ij,ij->i", drag, velocity)[moving] < 0.0).all()
    # The normal forces of a curved contact add up to less than their sum, so the
    # ratio may exceed μ a little where they spread.
    ratio = np.linalg.norm(drag, axis=1) / np.linalg.norm(smooth.force, axis=1)
    assert ratio.max() < 0.25 * 1.2
    assert np.median(ratio[moving]) == pytest.approx(0.25, rel=0.1)


def test_noise_has_the_stated_deviation_and_follows_its_seed():
    n = 4000
    rest = still_path(n, wrench=(np.ones((n, 3)), np.zeros((n, 3))))
    noisy = add_noise(rest, np.random.default_rng(1))
    again = add_noise(rest, np.random.default_rng(1))
    other = add_noise(rest, np.random.default_rng(2))
    # 12,000 samples: the deviation is known to 0.65 %, so 3 % is over four sigma.
    assert (noisy.force - 1.0).std() == pytest.approx(0.08, rel=0.03)
    assert noisy.torque.std() == pytest.approx(0.003, rel=0.03)
    assert abs((noisy.force - 1.0).mean()) < 4 * 0.08 / np.sqrt(3 * n)
    assert np.array_equal(noisy.force, again.force)
    assert not np.array_equal(noisy.force, other.force)


def test_compact_file_reads_back_to_seven_digits(smooth, tmp_path):
    file = tmp_path / "sweep.csv"
    smooth.save(file, digits=7)
    read = read_trajectory(file)
    assert read.position == pytest.approx(smooth.position, rel=1e-6)
    assert read.rotation == pytest.approx(smooth.rotation, abs=1e-6)
    assert read.force == pytest.approx(smooth.force, rel=1e-6)
    assert read.torque == pytest.approx(smooth.torque, rel=1e-6)


def test_refuses_trajectories_without_a_wrench():
    path = poses("press_fit")
    refuses(InputError, "no wrench", add_noise, path, np.random.default_rng(0))


def still_path(n, step=0.05, wrench=()):
    time = step * np.arange(n)
    turns = np.tile(np.eye(3), (n, 1, 1))
    return Trajectory(time, np.zeros((n, 3)), turns, *wrench)


@pytest.mark.parametrize("correlation", [0.0, 1.0])
def test_pose_noise_has_the_deviations_and_the_correlation_asked_for(correlation):
    path, noise = still_path(40_000), TrackerNoise(correlation=correlation)
    noisy = add_pose_noise(path, np.random.default_rng(3), noise)
    turn = Rotation.from_matrix(noisy.rotation).as_rotvec()
    for values, std in ((noisy.position, 0.5e-3), (turn, np.radians(0.5))):
        assert values.std(axis=0) == pytest.approx(np.full(3, std), rel=0.1)
        unit = values / std
        alike = (unit[1:] * unit[:-1]).mean()
        expected = np.exp(-0.05) if correlation else 0.0
        assert alike == pytest.approx(expected, abs=0.08)
    rng = np.random.default_rng(3)
    short = add_pose_noise(still_path(20), rng, noise)
    assert noisy.position[:20] == pytest.approx(short.position)


def test_refuses_a_negative_correlation_of_poses():
    with pytest.raises(InputError, match="correlation time must be finite"):
        TrackerNoise(correlation=-1.0)
