"""Intrinsics as OpenCV and ROS write them, and what is no intrinsics."""

import json

import numpy as np
import pytest

from tests.kit import FileError, InputError, MissingPackageError, refuses
from ttus_opt.sensors.intrinsics import Intrinsics, read_intrinsics

K = [[618.6, 0.0, 321.984], [0.0, 619.11, 241.146], [0.0, 0.0, 1.0]]
FLAT = [value for row in K for value in row]

OPENCV = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [618.6, 0., 321.984, 0., 619.11, 241.146, 0., 0., 1.]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [0.1, -0.2, 0., 0., 0.05]
"""

ROS = """image_width: 640
image_height: 480
camera_name: head
camera_matrix:
  rows: 3
  cols: 3
  data: [618.6, 0, 321.984, 0, 619.11, 241.146, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.1, -0.2, 0, 0, 0.05]
"""

MESSAGE = """header: {frame_id: head}
height: 480
width: 640
distortion_model: plumb_bob
d: [0.1, -0.2, 0.0, 0.0, 0.05]
k: [618.6, 0.0, 321.984, 0.0, 619.11, 241.146, 0.0, 0.0, 1.0]
"""


@pytest.mark.parametrize("text", [OPENCV, ROS, MESSAGE])
def test_yaml_of_opencv_and_ros(tmp_path, text):
    pytest.importorskip("yaml", reason="needs ttus-opt[sensors]")
    (tmp_path / "camera.yaml").write_text(text)
    found = read_intrinsics(tmp_path / "camera.yaml")
    np.testing.assert_array_equal(found.matrix, K)
    np.testing.assert_array_equal(found.distortion, [0.1, -0.2, 0.0, 0.0, 0.05])
    assert found.size == (640, 480)


@pytest.mark.parametrize("matrix", [K, FLAT])
def test_json(tmp_path, matrix):
    (tmp_path / "camera.json").write_text(json.dumps({"camera_matrix": matrix}))
    found = read_intrinsics(tmp_path / "camera.json")
    np.testing.assert_array_equal(found.matrix, K)
    assert found.distortion.shape == (0,)
    assert found.size is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "YAML or JSON"),
        ("[" * 50_000, "YAML or JSON"),
        ("[1, 2]", "must map names"),
        ("{}", "nine numbers"),
        ('{"K": [1, 2, 3]}', "nine numbers"),
        ('{"K": "many"}', "not numbers"),
        (json.dumps({"K": [1, 0, 0, 0, 1, 0, 0, 0, 1]}), "normalised"),
        (json.dumps({"K": np.transpose(K).tolist()}), "transposed"),
        (json.dumps({"K": [float("nan")] * 9}), "finite numbers"),
        (json.dumps({"K": FLAT, "D": [1, 2]}), "distortion has"),
        (json.dumps({"K": FLAT, "D": [1e300] * 5}), "finite"),
        (json.dumps({"K": FLAT, "width": 0, "height": 3}), "0 x 3 pixels"),
        (json.dumps({"K": FLAT, "width": "a", "height": 3}), "not numbers"),
        (json.dumps({"K": FLAT, "distortion_model": "equidistant"}), "undistort"),
    ],
)
def test_what_is_no_intrinsics(tmp_path, text, words):
    (tmp_path / "camera.json").write_text(text)
    refuses(FileError, words, read_intrinsics, tmp_path / "camera.json")


def test_an_image_of_another_size():
    camera = Intrinsics(np.array(K), np.zeros(0), (640, 480))
    camera.check_shape((480, 640))
    refuses(InputError, "480 x 640 pixels", camera.check_shape, (640, 480))


def test_without_yaml_the_extra_is_named(tmp_path, monkeypatch):
    (tmp_path / "camera.yaml").write_text(ROS)
    monkeypatch.setitem(__import__("sys").modules, "yaml", None)
    with pytest.raises(MissingPackageError, match=r"ttus-opt\[sensors\]"):
        read_intrinsics(tmp_path / "camera.yaml")


REALSENSE = {
    **{"width": 640, "height": 480, "fx": 618.6, "fy": 619.11},
    **{"ppx": 321.984, "ppy": 241.146, "model": "Inverse Brown Conrady"},
    "coeffs": [0.0] * 5,
}
OPEN3D = {
    "intrinsic": {
        **{"width": 640, "height": 480},
        "intrinsic_matrix": np.array(K).T.ravel().tolist(),
    }
}
FILE_STORAGE = """<?xml version="1.0"?>
<opencv_storage>
<image_Width>640</image_Width>
<image_Height>480</image_Height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>618.6 0. 321.984
    0. 619.11 241.146 0. 0. 1.</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols>
  <dt>d</dt><data>0. 0. 0. 0. 0.</data></Distortion_Coefficients>
</opencv_storage>
"""


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("realsense.json", json.dumps(REALSENSE)),
        ("open3d.json", json.dumps(OPEN3D)),
        ("opencv.xml", FILE_STORAGE),
    ],
)
def test_other_makers(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    found = read_intrinsics(tmp_path / name)
    np.testing.assert_array_equal(found.matrix, K)
    assert found.size == (640, 480)
    assert not found.distortion.any()


def test_an_inverse_distortion_is_refused(tmp_path):
    (tmp_path / "c.json").write_text(json.dumps({**REALSENSE, "coeffs": [0.1] * 5}))
    with pytest.raises(FileError, match="Inverse Brown Conrady is not known"):
        read_intrinsics(tmp_path / "c.json")
