"""Planes, jumps and lonely pixels: angles by hand, neighbours by plain loops."""

import cv2
import numpy as np
import pytest

from tests.kit import InputError, refuses
from tests.sensors import cameras
from ttus_opt.sensors import depth
from ttus_opt.sensors.depth_noise import Pixels, StructuredLight, TimeOfFlight
from ttus_opt.sensors.intrinsics import Intrinsics
from ttus_opt.sensors.unprojection import Unprojection

SHAPE, FOCAL = (24, 30), 120.0
STEEPEST = np.deg2rad(80.0)


def straight_rays():
    v, u = np.indices(SHAPE, dtype=float)
    out = np.stack(
        [(u - SHAPE[1] / 2) / FOCAL, (v - SHAPE[0] / 2) / FOCAL, np.ones(SHAPE)], -1
    )
    return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))


def plane(normal, at=1.0):
    """Depth z of the plane n·X = n_z · at."""
    own = straight_rays()
    return np.asarray(normal[2] * at / (own @ normal) * own[..., 2])


@pytest.mark.parametrize("tilt", [0.0, 30.0, 60.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_incidence_on_a_plane_is_the_angle_to_its_normal(tilt, axis):
    turn = np.deg2rad(tilt)
    normal = np.array([0.0, 0.0, np.cos(turn)])
    normal[axis] = np.sin(turn)
    z = plane(normal)
    flying, incidence = depth.judge(
        z, straight_rays(), FOCAL, np.full(SHAPE, 1e-4), STEEPEST
    )
    kept = np.s_[depth.STEPS : -depth.STEPS, depth.STEPS : -depth.STEPS]
    assert not flying[kept].any()
    np.testing.assert_allclose(
        np.cos(incidence[kept]), (straight_rays() @ normal)[kept], atol=1e-9
    )


def test_pixels_beside_a_jump_are_flying_and_no_others():
    z = np.where(np.arange(SHAPE[1]) < 14, 1.0, 1.4) * np.ones(SHAPE)
    flying, incidence = depth.judge(
        z, straight_rays(), FOCAL, np.full(SHAPE, 1e-3), STEEPEST
    )
    expected = np.zeros(SHAPE, dtype=bool)
    expected[:, [13, 14]] = True
    np.testing.assert_array_equal(flying[2:-2, 2:-2], expected[2:-2, 2:-2])
    assert np.isnan(incidence[flying]).all()


def test_a_jump_within_the_noise_is_none():
    """Steps of 1 cm: gone at 5 mm of noise, there at a tenth of a millimetre."""
    z = np.where(np.arange(SHAPE[1]) < 14, 1.0, 1.01) * np.ones(SHAPE)
    level = np.deg2rad(10.0)  # nearly facing the camera
    noisy, _ = depth.judge(z, straight_rays(), FOCAL, np.full(SHAPE, 5e-3), level)
    exact, _ = depth.judge(z, straight_rays(), FOCAL, np.full(SHAPE, 1e-4), level)
    assert not noisy[:, 13:15].any()
    assert exact[2:-2, 13:15].all()


def test_a_lonely_pixel_is_flying_and_missing_ones_are_nothing():
    z = np.full(SHAPE, np.nan)
    z[4, 5] = 1.0
    z[12:20, 10:22] = 1.0
    flying, incidence = depth.judge(
        z, straight_rays(), FOCAL, np.full(SHAPE, 1e-3), STEEPEST
    )
    assert flying[4, 5]
    assert not flying[~np.isfinite(z)].any()
    assert np.isnan(incidence[~np.isfinite(z)]).all()
    assert np.isfinite(incidence[14:18, 12:20]).all()
    assert depth.LEAST_COUNT > 1


@pytest.mark.parametrize(("most", "stride"), [(1, 1), (2, 3), (2, 4), (2, 40)])
def test_neighbours_are_those_of_plain_loops(most, stride):
    """Every pixel meets those up to so many strides away, at their distance."""
    shape = (7, 9)
    number = np.arange(63).reshape(shape)
    found = []
    for there, here, distance in depth._neighbours(shape, most, stride):
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


CAMERA = cameras.Camera((0.1, 0.9, -0.2), (0.0, 0.1, 0.0))
CENTRE, SEMI_AXES = np.array([0, 0.11, 0]), np.array([0.17, 0.11, 0.35])
UP = np.array([0.0, 1.0, 0.0])


def rays(camera=CAMERA):
    return Unprojection.from_intrinsics(
        Intrinsics(camera.matrix, np.zeros(0)), camera.shape
    )


def seen(camera=CAMERA):
    """An ellipsoid on a bed."""
    body = cameras.see_ellipsoid(camera, CENTRE, SEMI_AXES)
    return np.minimum(body, cameras.see_plane(camera, UP, 0.0))


def off_the_body(points):
    """Distance to the ellipsoid, to first order, signed outwards [m]."""
    scaled = (points - CENTRE) / SEMI_AXES
    f = np.linalg.norm(scaled, axis=1)
    return (f - 1.0) * f / np.linalg.norm(scaled / SEMI_AXES, axis=1)


def distance(points):
    return np.minimum(np.abs(off_the_body(points)), np.abs(points[:, 1]))


def test_points_lie_on_what_was_seen(tmp_path):
    cv2.imwrite(str(tmp_path / "scan.png"), cameras.millimetres(seen()))
    camera = Intrinsics(CAMERA.matrix, np.zeros(0), (160, 120))
    cloud = depth.read_depth_image(tmp_path / "scan.png", camera).to_cloud(CAMERA.pose)
    assert distance(cloud.points).max() < 0.7e-3  # rounded to millimetres
    assert cloud.std is None
    (dropped,) = cloud.dropped
    assert dropped.invalid == 0
    left_out = dropped.flying + dropped.grazing
    assert len(cloud.points) == CAMERA.shape[0] * CAMERA.shape[1] - left_out


def test_range_and_z_are_the_same_scene():
    z = seen()
    along = z / rays().rays[..., 2]
    by_z = depth.DepthImage(z, rays()).to_cloud(CAMERA.pose)
    by_range = depth.DepthImage(along, rays(), "range").to_cloud(CAMERA.pose)
    np.testing.assert_allclose(by_range.points, by_z.points, atol=1e-12)
    mistaken = depth.DepthImage(along, rays()).to_cloud(CAMERA.pose)
    assert distance(mistaken.points).max() > 5e-3


def test_deviations_are_those_of_the_noise():
    rng = np.random.default_rng(1)
    model = StructuredLight()
    z, own = seen(), rays()
    distance_along = z / own.rays[..., 2]
    facing = Pixels(z, distance_along, np.zeros_like(z), own.focal)
    std = model.along_ray(facing) * own.rays[..., 2]
    image = depth.DepthImage(cameras.measured(z, std, 0.0, rng), own)
    cloud = image.to_cloud(CAMERA.pose, noise=model)
    bed = cloud.points[:, 1] < 0.02
    view = cloud.points[bed] - CAMERA.pose[:3, 3]
    cosine = -view[:, 1] / np.linalg.norm(view, axis=1)
    error = cloud.points[bed][:, 1] / cosine
    assert np.std(error / cloud.std[bed]) == pytest.approx(1.0, abs=0.05)
    flat = image.to_cloud(CAMERA.pose, noise=TimeOfFlight(0.004))
    assert set(flat.std.tolist()) == {0.004}


def test_refusals(tmp_path):
    z = seen()
    refuses(InputError, "depth_kind must be", depth.DepthImage, z, rays(), "disparity")
    refuses(InputError, "transposed", depth.DepthImage, z.T, rays())
    refuses(
        InputError, "not positive", depth.DepthImage, np.where(z > 0.9, 0.0, z), rays()
    )
    with pytest.raises(InputError, match="no pixel with a depth"):
        depth.DepthImage(np.full_like(z, np.nan), rays())
    image = depth.DepthImage(z, rays())
    refuses(InputError, "degrees", image.to_cloud, grazing=70.0)
    refuses(InputError, "scales by 2", image.to_cloud, np.diag([2.0, 2, 2, 1]))
    alone = np.full_like(z, np.nan)
    alone[::20, ::20] = 1.0
    refuses(
        InputError, "no pixel shows a surface", depth.DepthImage(alone, rays()).to_cloud
    )
    np.save(tmp_path / "scan.npy", z)
    camera = Intrinsics(CAMERA.matrix, np.zeros(0), (640, 480))
    with pytest.raises(InputError, match=r"scan\.npy.*640 x 480"):
        depth.read_depth_image(tmp_path / "scan.npy", camera)
