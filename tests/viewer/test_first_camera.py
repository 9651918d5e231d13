"""The first camera fits the page's shape, whatever the page reports when."""

from dataclasses import dataclass

import numpy as np
import pytest

from tests.kit import torso
from ttus_opt.viewer.first_camera import FIELD_OF_VIEW, SHAPES, FirstCamera
from ttus_opt.viewer.skin import SkinMesh

PHONE, DESK = (390, 700), (540, 560)  # the desk's panel leaves an almost square picture


@dataclass
class Camera:
    """What a page reports."""

    position: np.ndarray
    look_at: np.ndarray
    image_width: int
    image_height: int


@pytest.fixture(scope="module")
def first():
    return FirstCamera.of(torso(), float(np.ptp(torso().z)))


def test_a_page_is_told_its_camera_until_it_has_it(first):
    wide, tall, narrow = first.cameras
    camera = Camera(np.full(3, 3.0), np.zeros(3), *PHONE)  # viser's, at first
    first.settle(camera)
    np.testing.assert_array_equal(camera.position, np.full(3, 3.0))
    for _ in range(2):  # it may set the first one again
        camera.position, camera.look_at = (one.astype(np.float32) for one in wide)
        first.settle(camera)
        assert (camera.position, camera.look_at) == narrow
    camera.image_width, camera.image_height = reversed(PHONE)  # turned
    first.settle(camera)
    assert (camera.position, camera.look_at) == wide
    for size, own in (((490, 700), tall), ((375, 553), narrow)):
        camera.image_width, camera.image_height = size
        camera.position = wide[0]
        first.settle(camera)
        assert (camera.position, camera.look_at) == own


def test_a_page_that_was_turned_is_left_alone(first):
    position, middle = first.cameras[0]
    for size in (PHONE, DESK):
        turned = position + np.array([0.0, 0.01, 0.0])
        camera = Camera(turned, middle, *size)
        first.settle(camera)
        assert camera.position is turned
    camera = Camera(position, middle, *DESK)
    first.settle(camera)
    assert camera.position is position


@pytest.mark.parametrize(("shape", "aspect"), [(0, 0.8), (1, 0.6), (2, 0.5)])
def test_all_of_the_skin_is_in_the_picture(first, shape, aspect):
    assert aspect >= SHAPES[shape][0]
    position, middle = first.cameras[shape]
    forward = (middle - position) / np.linalg.norm(middle - position)
    right = np.cross(forward, first.front)
    right /= np.linalg.norm(right)
    off = SkinMesh.of(torso()).vertices - position
    half = np.tan(np.radians(0.5 * FIELD_OF_VIEW)) * (off @ forward)
    x, y = off @ right / (aspect * half), off @ np.cross(right, forward) / half
    assert max(np.abs(x).max(), np.abs(y).max()) < 1.0
    assert (y.mean() > 0.4) == (shape == 2)  # above the panel
