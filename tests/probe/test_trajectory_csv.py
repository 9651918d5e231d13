"""Every fault of a trajectory file is one line that names its place and remedy."""

import numpy as np
import pytest

from tests.kit import FileError, MistakeWarning, refuses
from ttus_opt.probe.trajectory import read_trajectory

HEADER = "t,px,py,pz,qw,qx,qy,qz,fx,fy,fz,tx,ty,tz"
ROW = "{t},0.1,0.2,0.3,1,0,0,0,1,2,3,0.01,0.02,0.03"


def rows(n=4):
    return [HEADER, *[ROW.format(t=0.05 * i) for i in range(n)]]


def with_cell(line, name, value):
    lines = rows()
    cells = lines[line - 1].split(",")
    cells[HEADER.split(",").index(name)] = value
    lines[line - 1] = ",".join(cells)
    return lines


def with_quaternion(line, *values):
    lines = rows()
    cells = lines[line - 1].split(",")
    cells[4:8] = values
    lines[line - 1] = ",".join(cells)
    return lines


def without(name):
    i = HEADER.split(",").index(name)
    return [",".join(c for j, c in enumerate(r.split(",")) if j != i) for r in rows()]


def refused(tmp_path, lines, text, end="\n"):
    file = tmp_path / "press.csv"
    file.write_text("\n".join(lines) + end)
    caught = refuses(FileError, text, read_trajectory, file)
    assert "press.csv" in caught


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        (without("qz"), "no column qz: the header must name"),
        (without("ty"), "no column ty"),
        (rows()[1:], "has no header: write t,px"),
        (["t," + rows()[0], *["0," + r for r in rows()[1:]]], "t more than once"),
        (rows(0), "empty"),
        (
            [*rows()[:2], rows()[1].replace("0.03", "0.04")],
            "line 3: time 0 s repeats 0 s: sort",
        ),
        (with_cell(4, "t", "0.01"), "line 4: time 0.01 s goes back from 0.05 s"),
        (with_cell(4, "fy", "nan"), r"line 4: fy is nan: remove the 1 line with"),
        (with_cell(2, "px", "inf"), "line 2: px is inf"),
        (with_cell(3, "tz", ""), "line 3: tz is empty"),
        (with_cell(3, "qx", "abc"), "line 3: qx is 'abc', not a number"),
        (with_cell(5, "py", "120.5"), r"line 5: 120.5 m .*millimetres"),
        (with_cell(5, "fz", "-2500"), r"line 5: 2500 N .*millinewtons"),
        (with_cell(5, "tz", "250"), r"line 5: 250 N m .*N mm"),
        (with_quaternion(3, "0", "0", "0", "0"), "line 3: the quaternion is zero"),
        (with_quaternion(4, "0", "1.02", "0", "0"), "line 4: .*length 1.02, expected"),
        ([*rows()[:-1], rows()[-1][:20]], "line 5: .*truncated"),
        ([*rows()[:2], "0.01,0.1", *rows()[3:]], "line 3: 2 cells, .*14: repair"),
        ([*rows()[:2], rows()[2] + ",7", *rows()[3:]], "line 3: 15 cells.*repair"),
    ],
)
def test_faults(tmp_path, lines, text):
    refused(tmp_path, lines, text)


def test_empty_lines_keep_the_count_of_lines(tmp_path):
    lines = with_cell(4, "fy", "nan")
    refused(tmp_path, [*lines[:2], "", *lines[2:]], "line 5: fy is nan")


def test_missing_empty_and_binary_files(tmp_path):
    refuses(FileError, "not found", read_trajectory, tmp_path / "no.csv")
    (tmp_path / "no.csv").touch()
    refuses(FileError, "is empty", read_trajectory, tmp_path / "no.csv")
    (tmp_path / "no.csv").write_bytes(b"\xff\xfe\x00\x81")
    refuses(FileError, "in UTF-8", read_trajectory, tmp_path / "no.csv")


def test_column_order_extra_columns_and_no_last_newline(tmp_path):
    names = ["qz", "qy", "qx", "note", "qw", "pz", "py", "px", "t"]
    cells = ["0", "0", "0", "first try", "1.001", "0.3", "0.2", "0.1", "5"]
    file = tmp_path / "poses.csv"
    file.write_text("\ufeff" + ",".join(names) + "\r\n" + ",".join(cells))
    trajectory = read_trajectory(file)
    assert len(trajectory) == 1 and not trajectory.has_wrench
    np.testing.assert_array_equal(trajectory.position, [[0.1, 0.2, 0.3]])
    np.testing.assert_allclose(trajectory.rotation[0], np.eye(3), atol=1e-15)
    assert trajectory.time[0] == 5


def test_segments_are_kept_apart(tmp_path):
    lines = [rows()[0] + ",segment"]
    lines += [r + f",{s}" for s in (3, 7) for r in rows()[1:]]
    (tmp_path / "two.csv").write_text("\n".join(lines))
    trajectory = read_trajectory(tmp_path / "two.csv")
    np.testing.assert_array_equal(trajectory.segment, [3] * 4 + [7] * 4)
    refused(tmp_path, [*lines, lines[1].replace("0.0", "9", 1)], "be contiguous")
    refused(tmp_path, [*lines[:-1], lines[-1][:-1] + "7.5"], "line 9: segment must be")


def test_times_in_milliseconds_are_doubted(tmp_path):
    file = tmp_path / "press.csv"
    file.write_text("\n".join([HEADER, *[ROW.format(t=50 * i) for i in range(4)]]))
    with pytest.warns(
        MistakeWarning, match="50 s apart: .* milliseconds\\? divide t by"
    ):
        read_trajectory(file)
    # one frame a second is slow, and a new recording may begin hours later
    lines = [
        HEADER + ",segment",
        *(ROW.format(t=t) + f",{t // 100}" for t in (0, 1, 900)),
    ]
    file.write_text("\n".join(lines))
    assert len(read_trajectory(file)) == 3
