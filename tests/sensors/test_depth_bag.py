"""A recording as RealSense's SDK writes it: depth images, intrinsics, depth units."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest

from tests.kit import FileError, InputError, refuses
from tests.sensors.bags import Bag
from ttus_opt.sensors.depth import read_depth_image
from ttus_opt.sensors.depth_files import read_depth
from ttus_opt.sensors.intrinsics import read_intrinsics

rosbags = pytest.importorskip("rosbags", reason="needs ttus-opt[sensors]")

SENSOR = "/device_0/sensor_0"
K = [60.0, 0.0, 16.0, 0.0, 60.0, 12.0, 0.0, 0.0, 1.0]

#: Another topic of depth images, of half the size
ALIGNED = "/camera/aligned_depth_to_color"

#: Time from one image to the next [ns]
FRAME = 33_000_000

#: A depth camera's unit that is not a millimetre, as a D405 has it [m]
UNIT = 1e-4


def depth(i):
    """Whole units; a hole, and a slope that grows by a unit a frame."""
    image = 5000 + 7 * np.arange(32)[None, :] + np.zeros((24, 1)) + i
    image[3, 4] = 0
    return image.astype(np.uint16)


class Camera(NamedTuple):
    """Images in whole units, and the matrix of their camera."""

    images: Sequence[np.ndarray] = tuple(depth(i) for i in range(5))
    K: Sequence[float] = tuple(K)
    unit: float = UNIT


SMALL = Camera()


def recorded(file, *, encoding="mono16", unit=True, camera=SMALL, aligned=False):
    streams = {
        (f"{SENSOR}/Depth_0/image/data", f"{SENSOR}/Depth_0/info/camera_info"): 1
    }
    if aligned:
        streams[f"{ALIGNED}/image_raw", f"{ALIGNED}/camera_info"] = 2
    with Bag(file) as bag:
        if unit:
            told = bag.Float32(camera.unit)
            bag.write(f"{SENSOR}/option/Depth Units/value", 0, told)
        for (data, info), part in streams.items():
            height, width = (n // part for n in camera.images[0].shape)
            matrix = np.array(camera.K) / [part, 1, part, 1, part, part, 1, 1, 1]
            roi = bag.RegionOfInterest(0, 0, 0, 0, False)
            told = bag.CameraInfo(
                *(bag.header(0, "0"), height, width, "Brown Conrady", np.zeros(5)),
                *(matrix, np.eye(3).ravel(), np.zeros(12), 0, 0, roi),
            )
            bag.write(info, 0, told)
            for i, whole in enumerate(camera.images):
                pixels = np.ascontiguousarray(whole[::part, ::part])
                size = height, width, encoding, 0, 2 * width
                header = bag.header(10**9 + i, "0")
                sent = bag.Image(header, *size, pixels.view(np.uint8).ravel())
                bag.write(data, FRAME * i, sent)
    return file


def test_the_middle_frame_in_its_own_unit(tmp_path):
    file = recorded(tmp_path / "scan.bag")
    found, _ = read_depth(file)
    expected = UNIT * depth(2)
    expected[3, 4] = np.nan
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    camera = read_intrinsics(file)
    np.testing.assert_array_equal(camera.matrix.ravel(), K)
    assert camera.size == (32, 24)
    image = read_depth_image(file, camera)
    assert image.depth.shape == (24, 32)


def test_millimetres_where_no_unit_is_stated(tmp_path):
    file = recorded(tmp_path / "scan.bag", encoding="16UC1", unit=False)
    np.testing.assert_allclose(read_depth(file)[0][0, 0], 5.002)


def test_an_image_by_its_topic_and_time(tmp_path):
    """Each topic has the intrinsics beside it; times count from its first image."""
    file = recorded(tmp_path / "two.bag", aligned=True)
    data = f"{SENSOR}/Depth_0/image/data"
    refuses(FileError, "several topics of depth images: /camera/al", read_depth, file)
    with pytest.raises(FileError, match="no topic /x of depth images: one of /camera"):
        read_depth(file, topic="/x")
    found, frame = read_depth(file, topic=data, at=0.1)
    assert frame[:3] == (data, 3, 5)
    np.testing.assert_allclose(frame[3:], (0.099, UNIT), rtol=1e-6)
    said = "image 4 of 5, 0.099 s after the first, in units of 0.1 mm"
    assert str(frame) == f"{data}, {said}"
    np.testing.assert_allclose(found[0, 0], UNIT * depth(3)[0, 0])
    for at, number in ((0.0, 0), (0.132, 4), (None, 2)):
        found, frame = read_depth(file, topic=f"{ALIGNED}/image_raw", at=at)
        assert frame is not None and frame.number == number
        np.testing.assert_allclose(found[0, 0], UNIT * depth(number)[0, 0])
    assert read_intrinsics(file, data).matrix[0, 0] == 60.0
    small = read_intrinsics(file, f"{ALIGNED}/image_raw")
    assert small.matrix[0, 0] == 30.0 and small.size == (16, 12)
    for at in (-0.1, 1.0):
        with pytest.raises(InputError, match="outside the recording"):
            read_depth(file, topic=data, at=at)


def test_what_is_refused(tmp_path):
    file = recorded(tmp_path / "scan.bag", encoding="rgb8")
    refuses(FileError, "images of rgb8", read_depth, file)
    (tmp_path / "no.bag").write_text("none")
    for read in (read_depth, read_intrinsics):
        refuses(
            FileError, "cannot be read as a ROS recording", read, tmp_path / "no.bag"
        )
