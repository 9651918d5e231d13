"""``ttus-opt register``."""

import json

import numpy as np
import pytest

from tests.cli.conftest import empty, refused
from tests.sensors.test_hand_eye import X, pairs
from ttus_opt.probe.rigid_motion import read_rigid_motion

K = {"K": [618.600, 0, 321.984, 0, 619.110, 241.146, 0, 0, 1]}
BOARD = "--dictionary 4X4_250 --marker 0.0256 --gap 0.0066"


@pytest.fixture
def given(tmp_path):
    """Files of pairs and intrinsics."""
    folder = tmp_path / "given"
    folder.mkdir()
    both = np.stack(pairs("fixed"), axis=1)
    (folder / "pairs.json").write_text(json.dumps(both.tolist()))
    (folder / "camera.json").write_text(json.dumps(K))
    return folder


def test_where_a_camera_is(run, given, output):
    words = f"register hand-eye {given / 'pairs.json'} --camera fixed"
    told = run(f"{words} -o {output / 'x.json'} --json").told
    assert told["loop_m"] < 1e-6
    assert len(told["solvers"]) == 7
    np.testing.assert_allclose(told["camera_to_base"], X, atol=1e-6)
    np.testing.assert_allclose(read_rigid_motion(output / "x.json"), X, atol=1e-6)
    assert "read as marker to camera and hand to base" in run(words).out


def test_poses_the_wrong_way_round(run, given, output):
    words = f"register hand-eye {given / 'pairs.json'} --camera moving"
    refused(run(f"{words} -o {output / 'x.json'}"), "--camera fixed", "do not close")
    assert empty(output)


def test_a_board_and_its_markers(run, shared, given, output):
    photo = shared / "markers" / "aruco_photo.png"
    words = f"register board {photo} --intrinsics {given / 'camera.json'} {BOARD}"
    answer = run(f"{words} --columns 3 --rows 4 -o {output / 'b.json'}")
    assert "12 markers, corners within 0.47 pixels" in answer.out
    assert read_rigid_motion(output / "b.json")[2, 3] == pytest.approx(0.49, abs=0.01)
    (output / "b.json").unlink()
    refused(run(f"{words} --columns 4 --rows 3 -o {output / 'b.json'}"), "41.9 pixels")
    assert empty(output)
    told = run(
        f"register markers {photo} --intrinsics {given / 'camera.json'} --dictionary "
        "4X4_250 --marker 0.0256 --json"
    ).told
    assert len(told["markers_to_camera"]) == 12


def test_what_is_refused(run, given, output):
    camera, to = given / "camera.json", f"-o {output / 'x.json'}"
    board = f"--intrinsics {camera} {BOARD} --columns 3 --rows 4 {to}"
    refused(run(f"register board {camera} {board}"), "as an image")
    refused(run(f"register board {given} {board}"), "folder")
    refused(run(f"register hand-eye {camera} --camera fixed {to}"), "pairs of poses")
    refused(run(f"register hand-eye {given / 'pairs.json'} {to}"), "--camera")
    both = f"register hand-eye {given / 'pairs.json'} --camera fixed"
    refused(run(f"{both} -o {given / 'pairs.json'}"), "--force")
    assert empty(output)
