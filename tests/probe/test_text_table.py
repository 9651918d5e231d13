"""Tables that other programs write."""

from pathlib import Path

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import FileError, InputError, refuses
from ttus_opt.probe.column_names import known_name
from ttus_opt.probe.text_table import read_text_table

OURS = ["t", "px", "py", "pz", "qw", "qx", "qy", "qz"]
OURS += ["fx", "fy", "fz", "tx", "ty", "tz"]
ROWS = [
    [0.05 * i, 0.1, 0.2, 0.3 + i, 0.6, 0.8, 0, 0, 1, 2, 3, 0.1, 0.2, 0.3]
    for i in range(3)
]
ROS = (
    "%time,field.header.seq,field.pose.position.x,field.pose.position.y,"
    "field.pose.position.z,field.pose.orientation.x,field.pose.orientation.y,"
    "field.pose.orientation.z,field.pose.orientation.w,field.wrench.force.x,"
    "field.wrench.force.y,field.wrench.force.z,field.wrench.torque.x,"
    "field.wrench.torque.y,field.wrench.torque.z"
)


def write(folder, header, rows):
    file = folder / "press.csv"
    file.write_text("\n".join([header, *rows, ""]))
    return file


def lines(separator):
    return [separator.join(map(str, row)) for row in ROWS]


@pytest.mark.parametrize("separator", [",", ";", "\t", "  ", " ; "])
def test_separators(tmp_path, separator):
    file = write(tmp_path, separator.join(OURS), lines(separator))
    read = tt.read_trajectory(file)
    np.testing.assert_array_equal(read.position, [row[1:4] for row in ROWS])
    np.testing.assert_array_equal(read.torque, [row[11:] for row in ROWS])


@pytest.mark.parametrize("mark", ["#", "##", "%", "//"])
def test_comments_and_a_header_that_is_one(tmp_path, mark):
    header = f"\n{mark} recorded by hand, in a hurry\n{mark} {','.join(OURS).upper()}"
    body = [lines(",")[0], f"{mark} a pause", "", *lines(",")[1:]]
    read = tt.read_trajectory(write(tmp_path, header, body))
    np.testing.assert_array_equal(read.force, [row[8:11] for row in ROWS])


def test_an_export_of_ros(tmp_path):
    """Names, order of the quaternion and whole nanoseconds as rostopic writes them."""
    body = [
        f"{1_700_000_000_000_000_000 + 50_000_000 * i},{i},{px},{py},{pz},{qx},{qy},"
        f"{qz},{qw},{','.join(map(str, rest))}"
        for i, (_, px, py, pz, qw, qx, qy, qz, *rest) in enumerate(ROWS)
    ]
    read = tt.read_trajectory(write(tmp_path, ROS, body))
    np.testing.assert_allclose(read.time - 1.7e9, [0.0, 0.05, 0.1], atol=1e-6)
    np.testing.assert_allclose(read.quat_wxyz[0], [0.6, 0.8, 0, 0], atol=1e-12)
    np.testing.assert_array_equal(read.torque, [row[11:] for row in ROWS])


def test_columns_are_told(tmp_path):
    header = ",".join(["tip_x" if n == "px" else n for n in OURS])
    file = write(tmp_path, header, lines(","))
    refuses(
        FileError, r"no column px: .*got t,tip_x,.* px=NAME", tt.read_trajectory, file
    )
    read = tt.read_trajectory(file, columns={"px": "tip_x"})
    np.testing.assert_array_equal(read.position[:, 0], 0.1)


def test_swapped_columns_are_swapped_back(tmp_path):
    file = write(tmp_path, ",".join(OURS), lines(","))
    read = tt.read_trajectory(file, columns={"px": "py", "py": "px"})
    np.testing.assert_array_equal(read.position[0], [0.2, 0.1, 0.3])


def test_of_two_poses_one_is_chosen(tmp_path):
    header = ",".join([*OURS, "target.position.x"])
    file = write(tmp_path, header, [f"{line},9" for line in lines(",")])
    refuses(FileError, "column px more than once", tt.read_trajectory, file)
    read = tt.read_trajectory(file, columns={"px": "target.position.x"})
    np.testing.assert_array_equal(read.position[:, 0], 9.0)


def test_a_told_column_that_is_not_there(tmp_path):
    file = write(tmp_path, ",".join(OURS), lines(","))
    with pytest.raises(InputError, match="columns names tip, but the header has t, px"):
        tt.read_trajectory(file, columns={"fx": "tip"})


@pytest.mark.parametrize(
    ("line", "extra", "told"),
    [(0, None, "repair"), (2, None, "truncated"), (2, "9", "repair")],
)
def test_a_line_of_another_length(tmp_path, line, extra, told):
    """A short last line was cut off; any other is damaged."""
    body = lines(",")
    body[line] = body[line][:-4] if extra is None else f"{body[line]},{extra}"
    with pytest.raises(FileError, match=rf"line {line + 2}: .*{told}"):
        tt.read_trajectory(write(tmp_path, ",".join(OURS), body))


def test_faults_of_any_length_are_told_shortly(tmp_path):
    wide = write(tmp_path, ",".join(f"c{i}" for i in range(9_999)), ["1"])
    with pytest.raises(FileError, match=r"c0,c1.*… \(9,999 in all\)") as told:
        tt.read_trajectory(wide)
    assert len(str(told.value)) < 600
    body = [line.replace("0.2", 5000 * "x") for line in lines(",")]
    with pytest.raises(FileError, match=r"py is 'xxx.*…, not a number") as told:
        tt.read_trajectory(write(tmp_path, ",".join(OURS), body))
    assert len(str(told.value)) < 300


def test_a_decimal_comma_is_named(tmp_path):
    body = [line.replace("0.2", "0,2") for line in lines(";")]
    with pytest.raises(FileError, match=r"line 2: py is '0,2'.*decimal comma"):
        tt.read_trajectory(write(tmp_path, ";".join(OURS), body))


def test_decimal_commas_between_commas_are_suspected(tmp_path):
    file = write(tmp_path, ",".join(OURS), [r.replace(".", ",") for r in lines(",")])
    refuses(FileError, "decimal commas", tt.read_trajectory, file)


def test_what_is_no_text(tmp_path, monkeypatch):
    """Told from the beginning: 1 GB of zeros is not read."""
    file = tmp_path / "press.csv"
    file.write_bytes("t,px".encode("utf-16"))
    refuses(FileError, "in UTF-16: save it in UTF-8", tt.read_trajectory, file)
    file.write_bytes("t,px\nn".encode("latin-1") + b"\xe9")
    refuses(FileError, "not a text file", tt.read_trajectory, file)
    with file.open("wb") as stream:
        stream.truncate(2**30)
    monkeypatch.setattr(Path, "read_text", lambda *_: pytest.fail("read"))
    refuses(FileError, "not a text file", tt.read_trajectory, file)


@pytest.mark.parametrize(
    ("name", "ours"),
    [
        ("T", "t"),
        ("/robot/pose/position/z", "pz"),
        ("transform.translation.y", "py"),
        ("transform.rotation.w", "qw"),
        ("wrench.torque.x", "tx"),
        ("Segment", "segment"),
        ("composition.x", "composition.x"),
        ("gain", "gain"),
    ],
)
def test_names(name, ours):
    assert known_name(name) == ours


def test_numbers_are_taken_whatever_their_form(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text('"t","x"\n"1e-3", -2 \n')
    values, unread = read_text_table(file, ["t"]).readable(["t", "x"])
    np.testing.assert_array_equal(values, [[1e-3, -2.0]])
    assert not unread
