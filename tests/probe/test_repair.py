"""Holes of a recording: all told at once, and mended where it is asked for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.kit import FileError, TtusWarning, refuses
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.probe.recording_faults import faults
from ttus_opt.probe.repair import repaired
from ttus_opt.probe.trajectory import read_trajectory

HEADER = "t,px,py,pz,qw,qx,qy,qz"


def table(n=40):
    """Twenty poses a second along a line."""
    return [[0.05 * i, 0.001 * i, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0] for i in range(n)]


def written(file, rows):
    file.write_text("\n".join([HEADER, *[",".join(map(str, r)) for r in rows]]) + "\n")
    return file


def broken():
    """Every kind of hole: lines 4, 10 to 12, 15, 20, 25, 30."""
    rows = table()
    rows[2][1] = "nan"
    rows[8][2] = rows[9][2] = rows[10][3] = ""
    rows[13][0] = 0.55  # came late
    rows[18] = [*rows[17][:1], *rows[18][1:]]  # a stamp again
    rows[23][4:] = [0.0, 0.0, 0.0, 0.0]
    rows[28][1] = 0.5  # the tracker lost it
    return rows


def test_one_error_lists_all(tmp_path):
    file = written(tmp_path / "press.csv", broken())
    text = refuses(FileError, "", read_trajectory, file)
    assert "\n" not in text
    for words in (
        "4 kinds of faults",
        "line 4: px is nan (and 3 more)",
        "line 15: time 0.55 s goes back from 0.6 s",
        "line 20: time 0.85 s repeats 0.85 s",
        "line 25: the quaternion is zero",
        "repair=True",
    ):
        assert words in text


def test_repair_says_what_it_did(tmp_path):
    file = written(tmp_path / "press.csv", broken())
    with pytest.warns(TtusWarning) as told:
        found = read_trajectory(file, repair=True)
    (warning,) = [str(w.message) for w in told]
    for words in (
        "dropped 4 rows with missing values",
        "dropped 1 row without a unit quaternion",
        "sorted 1 row that came late",
        "dropped 2 rows with a repeated time stamp",
        "split at jumps (2)",
        "dropped 1 row alone between two splits",
    ):
        assert words in warning
    assert (np.diff(found.time)[np.diff(found.segment) == 0] > 0).all()
    assert found.position[:, 0].max() < 0.04  # the jump is gone
    # what was sound is as it was
    kept = np.round(found.time / 0.05).astype(int)
    np.testing.assert_allclose(found.position[:, 0], 0.001 * kept, atol=1e-3)


def test_gaps_and_resets_begin_a_segment():
    time = np.r_[0.05 * np.arange(20), 3.0 + 0.05 * np.arange(20)]
    time = np.r_[time, time]  # the clock was set back
    turn = np.tile([1.0, 0, 0, 0], (80, 1))
    raw = RawRecording("x", time, np.outer(np.arange(80), [1e-4, 0, 0]), turn)
    found, done = repaired(raw)
    assert len(found) == 80
    assert [int((found.segment == s).sum()) for s in range(4)] == [20] * 4
    assert done == ("split where the clock was set back (1)", "split at gaps (2)")


def test_a_sound_recording_is_left_alone(tmp_path):
    raw = RawRecording("x", 0.05 * np.arange(9.0), force=np.ones((9, 3)))
    _, done = repaired(raw.replaced(force=np.arange(27.0).reshape(9, 3)))
    assert done == ()


def test_nothing_left_is_an_error():
    raw = RawRecording("x", np.arange(4.0), force=np.full((4, 3), np.nan))
    refuses(FileError, "no row is left", repaired, raw)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_what_is_repaired_has_no_fault_that_repair_is_for(seed):
    """Any mixture of holes; and a second repair finds nothing but what it split."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(20, 80))
    time = 0.05 * np.arange(n)
    position = np.outer(np.sin(time), [0.1, 0.05, 0.0])
    quaternion = np.tile([1.0, 0, 0, 0], (n, 1))
    for _ in range(int(rng.integers(0, 5))):
        position[rng.integers(n)] += rng.choice([np.nan, 0.5, np.inf])
    for _ in range(int(rng.integers(0, 5))):
        i = rng.integers(1, n)
        time[i] = time[i - 1] - rng.choice([0.0, 0.07])
    quaternion[rng.integers(n)] *= rng.choice([1.0, 0.0, 3.0])
    try:
        found, _ = repaired(RawRecording("x", time, position, quaternion))
    except FileError:
        return
    assert not [fault for fault in faults(found) if fault.repairable]


def test_a_quaternion_whose_square_overflows_is_told(tmp_path):
    rows = table()
    rows[0][4:] = [1e200] * 4
    file = written(tmp_path / "far.csv", rows)
    refuses(FileError, "quaternion has length 2e\\+200", read_trajectory, file)
