"""Streams put together: exact where it can be, nothing across gaps."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import FileError, InputError, refuses
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.stream_files import read_wrenches
from ttus_opt.sensors.streams import WrenchStream, poses_at, with_wrenches


def turning(time):
    """Steady motion and a steady turn, which interpolation follows exactly."""
    turns = Rotation.from_rotvec(np.outer(time, [0.2, -0.5, 0.3])).as_matrix()
    return Trajectory(time, np.outer(time, [0.1, 0.0, -0.02]), turns)


def stream(time):
    return WrenchStream(time, np.outer(time, [1.0, 2, 3]), np.outer(time, [4.0, 5, 6]))


def test_poses_at_other_times_follow_a_steady_turn():
    at = np.array([0.03, 0.5, 1.77])
    found = poses_at(turning(np.arange(0, 2.01, 0.25)), at, largest_gap=0.3)
    truth = turning(at)
    np.testing.assert_allclose(found.rotation, truth.rotation, atol=1e-12)
    np.testing.assert_allclose(found.position, truth.position, atol=1e-15)
    assert set(found.segment) == {0}


def test_a_gap_of_poses_is_not_bridged():
    time = np.array([0.0, 0.1, 0.2, 0.9, 1.0, 1.1])
    at = np.array([-0.1, 0.05, 0.15, 0.5, 0.95, 1.05, 1.2])
    found = poses_at(turning(time), at, largest_gap=0.3)
    np.testing.assert_array_equal(found.time, [0.05, 0.15, 0.95, 1.05])
    assert found.segment.tolist() == [0, 0, 1, 1]
    # no time falls into the gap: still another segment
    found = poses_at(turning(time), at[[1, 2, 4, 5]], largest_gap=0.3)
    assert found.segment.tolist() == [0, 0, 1, 1]


def test_wrenches_at_the_instants_of_poses():
    poses = turning(np.arange(1.0, 2.0, 0.05))
    found = with_wrenches(poses, stream(np.arange(0, 3, 0.007)), 0.4, largest_gap=0.1)
    np.testing.assert_allclose(found.force, np.outer(poses.time - 0.4, [1, 2, 3]))
    np.testing.assert_allclose(found.torque, np.outer(poses.time - 0.4, [4, 5, 6]))
    np.testing.assert_array_equal(found.time, poses.time)


def test_a_gap_of_wrenches_is_not_bridged():
    time = np.arange(0, 3, 0.01)
    holed = stream(time[(time < 1.0) | (time > 1.6)])
    poses = turning(np.arange(0.0, 2.5, 0.05))
    found = with_wrenches(poses, holed, 0.0, largest_gap=0.1)
    inside = (found.time > 1.0) & (found.time < 1.6)
    assert not inside.any()
    assert set(found.segment) == {0, 1}
    assert (found.segment == (found.time > 1.3)).all()


def test_what_is_refused():
    poses, readings = turning(np.arange(0, 1, 0.1)), stream(np.arange(0, 1, 0.1))
    with pytest.raises(InputError, match="check the offset"):
        with_wrenches(poses, readings, 50.0, largest_gap=0.2)
    refuses(InputError, "gap", with_wrenches, poses, readings, 0.0, largest_gap=0.0)
    with pytest.raises(InputError, match="check the offset"):
        poses_at(poses, np.array([5.0]), largest_gap=0.2)
    refuses(InputError, "gap", poses_at, poses, np.array([0.5]), largest_gap=np.nan)
    with pytest.raises(InputError, match="2 or more"):
        poses_at(poses.select(slice(0, 1)), np.array([0.0]), largest_gap=0.2)
    refuses(InputError, "increase", stream, np.array([0.0, 0.0]))
    refuses(InputError, "at least 2", stream, np.array([0.0]))
    refuses(InputError, "counts", WrenchStream, np.arange(2.0), np.full((2, 3), 1e6))
    refuses(InputError, "finite", WrenchStream, np.arange(2.0), np.full((2, 3), np.nan))


def table(file):
    time = np.arange(1000.0, 1010.0, 0.5)
    rows = np.column_stack([time, np.outer(time, np.ones(6)) / 1000])
    lines = ["time;force.x;force.y;force.z;torque.x;torque.y;torque.z"]
    lines += [";".join(f"{v:.4f}" for v in row) for row in rows]
    file.write_text("\n".join(lines))
    return file


def test_a_table_of_wrenches(tmp_path):
    found = read_wrenches(table(tmp_path / "w.csv"))
    assert found.torque is not None
    np.testing.assert_allclose(found.time, np.arange(1000.0, 1010.0, 0.5))
    np.testing.assert_allclose(found.force[2], [1.001] * 3)
    (tmp_path / "f.csv").write_text("stamp,fx,fy,fz\n0,1,2,3\n1,4,5,6\n")
    found = read_wrenches(tmp_path / "f.csv", columns={"t": "stamp"})
    assert found.torque is None
    assert found.force.tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.filterwarnings("ignore:.*equal to the row before")
@pytest.mark.parametrize(
    "text", ["t,fx,fy\n0,1,2\n", "t,fx,fy,fz\n0,1,2,3\n0,1,2,4\n", "t,fx,fy,fz\n"]
)
def test_tables_that_are_none(tmp_path, text):
    (tmp_path / "w.csv").write_text(text)
    refuses(FileError, "", read_wrenches, tmp_path / "w.csv")
