"""Planes, jumps and lonely pixels: angles by hand, neighbours by plain loops."""

import numpy as np
import pytest

from ttus_opt.sensors.depth_pixels import LEAST_COUNT, STEPS, _neighbours, judge

SHAPE, FOCAL = (24, 30), 120.0
STEEPEST = np.deg2rad(80.0)


def rays():
    v, u = np.indices(SHAPE, dtype=float)
    out = np.stack(
        [(u - SHAPE[1] / 2) / FOCAL, (v - SHAPE[0] / 2) / FOCAL, np.ones(SHAPE)], -1
    )
    return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))


def plane(normal, at=1.0):
    """Depth z of the plane n·X = n_z · at."""
    own = rays()
    return np.asarray(normal[2] * at / (own @ normal) * own[..., 2])


@pytest.mark.parametrize("tilt", [0.0, 30.0, 60.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_incidence_on_a_plane_is_the_angle_to_its_normal(tilt, axis):
    turn = np.deg2rad(tilt)
    normal = np.array([0.0, 0.0, np.cos(turn)])
    normal[axis] = np.sin(turn)
    z = plane(normal)
    found = judge(z, rays(), FOCAL, np.full(SHAPE, 1e-4), STEEPEST)
    kept = np.s_[STEPS:-STEPS, STEPS:-STEPS]
    assert not found.flying[kept].any()
    np.testing.assert_allclose(
        np.cos(found.incidence[kept]), (rays() @ normal)[kept], atol=1e-9
    )


def test_pixels_beside_a_jump_are_flying_and_no_others():
    z = np.where(np.arange(SHAPE[1]) < 14, 1.0, 1.4) * np.ones(SHAPE)
    found = judge(z, rays(), FOCAL, np.full(SHAPE, 1e-3), STEEPEST)
    expected = np.zeros(SHAPE, dtype=bool)
    expected[:, [13, 14]] = True
    np.testing.assert_array_equal(found.flying[2:-2, 2:-2], expected[2:-2, 2:-2])
    assert np.isnan(found.incidence[found.flying]).all()


def test_a_jump_within_the_noise_is_none():
    """Steps of 1 cm: gone at 5 mm of noise, there at a tenth of a millimetre."""
    z = np.where(np.arange(SHAPE[1]) < 14, 1.0, 1.01) * np.ones(SHAPE)
    level = np.deg2rad(10.0)  # nearly facing the camera
    noisy = judge(z, rays(), FOCAL, np.full(SHAPE, 5e-3), level)
    exact = judge(z, rays(), FOCAL, np.full(SHAPE, 1e-4), level)
    assert not noisy.flying[:, 13:15].any()
    assert exact.flying[2:-2, 13:15].all()


def test_a_lonely_pixel_is_flying_and_missing_ones_are_nothing():
    z = np.full(SHAPE, np.nan)
    z[4, 5] = 1.0
    z[12:20, 10:22] = 1.0
    found = judge(z, rays(), FOCAL, np.full(SHAPE, 1e-3), STEEPEST)
    assert found.flying[4, 5]
    assert not found.flying[~np.isfinite(z)].any()
    assert np.isnan(found.incidence[~np.isfinite(z)]).all()
    assert np.isfinite(found.incidence[14:18, 12:20]).all()
    assert LEAST_COUNT > 1


@pytest.mark.parametrize(("most", "stride"), [(1, 1), (2, 3), (2, 4), (2, 40)])
def test_neighbours_are_those_of_plain_loops(most, stride):
    """Every pixel meets those up to so many strides away, at their distance."""
    shape = (7, 9)
    number = np.arange(63).reshape(shape)
    found = []
    for there, here, distance in _neighbours(shape, most, stride):
        pairs = zip(number[here].ravel(), number[there].ravel(), strict=True)
        found += [(int(a), int(b), round(distance, 9)) for a, b in pairs]
    expected = []
    for i in range(-most, most + 1):
        for j in range(-most, most + 1):
            for a in range(7):
                for b in range(9):
                    c, d = a + i * stride, b + j * stride
                    if 0 <= c < 7 and 0 <= d < 9:
                        far = round(stride * float(np.hypot(i, j)), 9)
                        expected.append((9 * a + b, 9 * c + d, far))
    assert sorted(found) == sorted(expected)
