"""Rigid motions from words and files, and what is none."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import FileError, InputError, refuses
from ttus_opt.probe.rigid_motion import (
    homogeneous,
    inverse,
    left_jacobian,
    motion_of,
    read_rigid_motion,
    rigid_motion,
    six_of,
)

TURN = Rotation.from_rotvec([0.3, -1.1, 0.7])
SHIFT = np.array([0.4, -0.2, 1.5])


def motion(turn=None, shift=SHIFT):
    out = np.eye(4)
    out[:3, :3] = TURN.as_matrix() if turn is None else turn
    out[:3, 3] = shift
    return out


def test_the_inverse_leads_back():
    np.testing.assert_allclose(inverse(motion()), np.linalg.inv(motion()), atol=1e-15)


def test_a_scipy_motion():
    transform = pytest.importorskip("scipy.spatial.transform")
    if not hasattr(transform, "RigidTransform"):
        pytest.skip("RigidTransform came with SciPy 1.16")
    own = transform.RigidTransform.from_components(SHIFT, TURN)
    np.testing.assert_allclose(rigid_motion(own), motion(), atol=1e-15)


def test_every_way_to_write_it(tmp_path):
    seven = [*SHIFT, *TURN.as_quat()]
    told = {
        "words": ",".join(map(repr, map(float, seven))),
        "json": json.dumps(motion().tolist()),
    }
    files = {
        "blanks.txt": "# base to scan\n"
        + "\n".join(" ".join(map(repr, row)) for row in motion().tolist()),
        "m.csv": "\n".join(",".join(map(repr, row)) for row in motion().tolist()),
        "m.json": told["json"],
        "seven.txt": told["words"],
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
        told[name] = str(tmp_path / name)
    np.save(tmp_path / "m.npy", motion())
    told["npy"] = str(tmp_path / "m.npy")
    for way, text in told.items():
        np.testing.assert_allclose(read_rigid_motion(text), motion(), atol=1e-12), way


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (motion(1000.0 * TURN.as_matrix()), "scales by 1000: remove the scale"),
        (motion(np.diag([1.0, 1.0, -1.0])), "a reflection"),
        (motion(np.diag([1.0, 1.0, 1.1])), "off the identity by 0.21"),
        (motion(shift=np.array([0.0, 400.0, 0.0])), "400 m, .*millimetres"),
        (motion().T, "transposed"),
        (np.full((4, 4), np.nan), "NaN"),
        (np.eye(3), r"matrix \(4, 4\), got \(3, 3\)"),
    ],
)
def test_what_is_no_rigid_motion(matrix, message):
    refuses(InputError, message, rigid_motion, matrix)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"1 2 3\n", "got 3 numbers"),
        (b"0 0 0 1 1 1 1\n", "length 2, expected 1"),
        (b"one two\n", r"cannot be read .*x,y,z,qx,qy,qz,qw"),
        (b"# nothing\n", "cannot be read"),
        (b"\xff\xfe\x00", "cannot be read"),
        (b"1 " * 60_000, "too large"),
        (b"0 0 0 nan 0 0 1", "NaN"),
    ],
)
def test_a_file_that_holds_none(content, message, tmp_path):
    path = tmp_path / "m.txt"
    path.write_bytes(content)
    caught = refuses(FileError, message, read_rigid_motion, path)
    assert "m.txt" in caught


def test_words_that_are_no_file():
    refuses(FileError, "not found: nowhere", read_rigid_motion, "nowhere")
    refuses(InputError, "got 3 numbers", read_rigid_motion, "1,2,3")
    refuses(InputError, "got 17 numbers", read_rigid_motion, ",".join("1" * 17))


@pytest.mark.parametrize("turn", [[0.3, -0.2, 0.5], [2.0, 1.0, -1.5], [1e-6, 0, 0]])
def test_six_numbers_and_a_small_turn_after_them(turn):
    six = np.array([*turn, 0.1, -0.2, 0.3])
    np.testing.assert_allclose(six_of(motion_of(six)), six, atol=1e-12)
    small = np.array([2e-6, -1e-6, 3e-6, 0.0, 0.0, 0.0])
    after = motion_of(small)[:3, :3] @ motion_of(six)[:3, :3]
    change = six_of(homogeneous(after, six[3:])) - six
    np.testing.assert_allclose(left_jacobian(six) @ change, small, atol=1e-10)
