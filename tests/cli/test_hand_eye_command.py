"""``ttus-opt hand-eye``: from two files to a motion that other commands read."""

import numpy as np
import pytest

from tests.cli.conftest import refused
from tests.sensors.test_stream_hand_eye import CAMERA, LATE, streams
from ttus_opt.probe.rigid_motion import read_rigid_motion


@pytest.mark.slow
def test_two_files(run, tmp_path):
    seen, carried = streams(outliers=0.05)
    seen.save(tmp_path / "tracker.csv")
    carried.save(tmp_path / "robot.csv")
    files = f"{tmp_path / 'tracker.csv'} {tmp_path / 'robot.csv'}"
    words = f"hand-eye {files} --camera fixed -o {tmp_path / 'x.json'}"
    told = run(f"{words} --largest-offset 1.5 --json").told
    found = read_rigid_motion(tmp_path / "x.json")
    np.testing.assert_allclose(found, CAMERA, atol=2e-3)
    np.testing.assert_array_equal(told["camera_to_base"], found)
    assert told["offset_s"] == pytest.approx(LATE, abs=2e-3)
    off = np.abs(found[:3, 3] - CAMERA[:3, 3])
    assert (off < 5 * np.array(told["position_std_m"])).all()
    text = run(f"{words} --offset {LATE} --force").out
    assert "camera to base: (1." in text and "mm, ±" in text


def test_the_hands_file_is_told_by_its_own_options(run, tmp_path):
    seen, carried = streams()
    seen.save(tmp_path / "tracker.csv")
    carried.save(tmp_path / "robot.csv")
    text = (tmp_path / "robot.csv").read_text()
    (tmp_path / "robot.csv").write_text(text.replace("px", "left", 1))
    files = f"{tmp_path / 'tracker.csv'} {tmp_path / 'robot.csv'}"
    refused(run(f"hand-eye {files} --camera fixed"), "by --hand-columns px=")
