"""Which column is which: words, YAML, and orders that are never guessed."""

import numpy as np
import pytest

from tests.kit import InputError, refuses
from ttus_opt.sensors.column_map import column_map, read_column_map
from ttus_opt.sensors.stream_files import read_poses, read_wrenches

MAP = """
t: stamp
position: [x, y, z]
quaternion: [q1, q2, q3, q4]
quaternion_order: xyzw
force: [F1, F2, F3]
"""

TABLE = "stamp,x,y,z,q1,q2,q3,q4\n0,1,2,3,0,0,0.6,0.8\n1,1,2,3,0,0,0.6,0.8\n"
FORCES = "stamp;F1;F2;F3\n0;1;2;3\n1;4;5;6\n"


def test_words():
    assert read_column_map("px=tip_x, fx = F1") == {"px": "tip_x", "fx": "F1"}
    assert read_column_map("") == {}


def test_lists_are_taken_apart():
    order = {"quaternion": ["a", "b", "c", "d"]}
    found = column_map({**order, "quaternion_order": "xyzw"})
    assert found == {"qx": "a", "qy": "b", "qz": "c", "qw": "d"}
    found = column_map({**order, "quaternion_order": "wxyz"})
    assert found == {"qw": "a", "qx": "b", "qy": "c", "qz": "d"}
    assert column_map({"torque": ["a", "b", "c"]}) == {"tx": "a", "ty": "b", "tz": "c"}


def test_one_file_for_both_streams(tmp_path):
    pytest.importorskip("yaml", reason="needs ttus-opt[sensors]")
    (tmp_path / "map.yaml").write_text(MAP)
    (tmp_path / "poses.csv").write_text(TABLE)
    (tmp_path / "forces.csv").write_text(FORCES)
    named = read_column_map(tmp_path / "map.yaml")
    poses = read_poses(tmp_path / "poses.csv", columns=named)
    # a turn about z by 2 atan(0.6 / 0.8)
    np.testing.assert_allclose(poses.rotation[0, 1, 0], 0.96)
    np.testing.assert_allclose(poses.position[1], [1, 2, 3])
    wrenches = read_wrenches(tmp_path / "forces.csv", columns=named)
    assert wrenches.force.tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"quaternion": ["a", "b", "c", "d"]}, "never guessed"),
        ({"quaternion": list("abcd"), "quaternion_order": "xywz"}, "wxyz or xyzw"),
        ({"quaternion": list("abc"), "quaternion_order": "xyzw"}, "has 4 components"),
        ({"position": ["a", "b"]}, "has 3 components"),
        ({"position": ["a", "b", 3]}, "must name a column, got 3"),
        ({"t": ["a"]}, "t must be one column"),
        ({"speed": "v"}, "columns has no 'speed'"),
        ({"px": "x", "py": "x"}, "names x twice"),
        ({"px": ""}, "must name a column"),
    ],
)
def test_what_is_refused(told, words):
    refuses(InputError, words, column_map, told)


def test_files_without_columns(tmp_path):
    (tmp_path / "a.csv").write_text(TABLE)
    with pytest.raises(InputError, match="list the columns of position"):
        read_poses(tmp_path / "a.csv", columns={"position": "tip"})
    with pytest.raises(InputError, match="leave the name out"):
        read_poses(tmp_path / "a.csv", "ProbeToTracker")
    with pytest.raises(InputError, match="leave the column map out"):
        read_poses(tmp_path / "a.mha", columns={"px": "x"})
    refuses(InputError, "NAME=COLUMN", read_column_map, "px")
