"""Rays by intrinsics, against projection, and from a table."""

import cv2
import numpy as np
import pytest

from tests.kit import FileError, InputError, refuses
from ttus_opt.sensors.intrinsics import Intrinsics
from ttus_opt.sensors.unprojection import Unprojection, read_unprojection

K = np.array([[150.0, 0, 79.0], [0, 155.0, 60.0], [0, 0, 1]])
SHAPE = (120, 160)


@pytest.mark.parametrize(
    "distortion",
    [[], [0.1, -0.2, 0.001, -0.002, 0.05], [0.2, 0.1, 0, 0, 0.1, 0.3, 0.1, 0.05]],
)
def test_every_ray_projects_to_its_pixel(distortion):
    D = np.array(distortion, float)
    found = Unprojection.from_intrinsics(Intrinsics(K, D), SHAPE)
    seen = np.isfinite(found.rays).all(axis=2)
    assert seen.mean() > 0.99
    np.testing.assert_allclose(np.linalg.norm(found.rays[seen], axis=1), 1.0)
    v, u = np.indices(SHAPE)
    zero = np.zeros(3)
    pixels, _ = cv2.projectPoints(found.rays[seen], zero, zero, K, D)
    np.testing.assert_allclose(pixels[:, 0], np.stack([u, v], -1)[seen], atol=0.05)
    assert found.focal == pytest.approx(150.0, rel=0.1)


def test_the_focal_length_is_a_median_over_all_rows():
    """Of a table whose first row alone has other steps."""
    x, y = np.meshgrid(np.arange(6.0), np.arange(5.0))
    x[0] *= 3.0
    rays = np.stack([0.02 * x, 0.02 * y, np.ones_like(x)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    assert Unprojection(rays).focal == pytest.approx(50.0)


def test_pixels_where_no_distortion_can_be_undone():
    """Beyond the largest radius that this distortion reaches nothing is seen."""
    D = np.array([-0.8, 0, 0, 0, 0.0])
    found = Unprojection.from_intrinsics(Intrinsics(K, D), SHAPE)
    seen = np.isfinite(found.rays).all(axis=2)
    assert seen[60, 79]
    assert not seen[0, 0]
    v, u = np.nonzero(seen)
    x, y = ((found.rays[seen] / found.rays[seen][:, 2:])[:, :2]).T
    radius = np.hypot(x, y)
    factor = 1 - 0.8 * radius**2
    np.testing.assert_allclose(150 * x * factor + 79, u, atol=0.05)
    np.testing.assert_allclose(155 * y * factor + 60, v, atol=0.05)


@pytest.mark.parametrize("n", [2, 3])
def test_a_table(tmp_path, n):
    own = Unprojection.from_intrinsics(Intrinsics(K, np.zeros(0)), SHAPE)
    table = own.rays / own.rays[..., 2:]
    table[0, 0] = np.nan
    np.save(tmp_path / "rays.npy", 3.0 * table if n == 3 else table[..., :2])
    found = read_unprojection(tmp_path / "rays.npy")
    assert np.isnan(found.rays[0, 0]).all()
    np.testing.assert_allclose(found.rays[1:], own.rays[1:], atol=1e-12)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.zeros((20, 30)), "height, width, 3"),
        (np.zeros((3, 20, 30)), "transposed"),
        (np.zeros((20, 30, 3)), "no pixel has a ray"),
        (np.full((20, 30, 3), np.nan), "no pixel has a ray"),
        (-np.ones((20, 30, 3)), "negate y and z"),
        (np.array([["a"]]), "expected numbers"),
    ],
)
def test_what_is_no_table(tmp_path, values, words):
    np.save(tmp_path / "rays.npy", values)
    refuses(FileError, words, read_unprojection, tmp_path / "rays.npy")


def test_no_rays():
    refuses(InputError, "unit vectors", Unprojection, np.ones((20, 30, 3)))
    refuses(InputError, r"height, width, 3", Unprojection, np.ones((20, 30)))
