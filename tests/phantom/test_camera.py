import numpy as np
import pytest

from tests.kit import InputError, refuses
from ttus_opt.phantom.camera import ScanSetup, View, depth_image, scan, write_cloud
from ttus_opt.phantom.torso import Torso
from ttus_opt.scan.cloud import read_cloud

TORSO = Torso()
SETUP = ScanSetup(TORSO)
VIEW = View((0.5, 0.8, 0.15))


def radial_error(points):
    theta = np.arctan2(points[:, 1], points[:, 0])
    return np.hypot(points[:, 0], points[:, 1]) - TORSO.radius(theta, points[:, 2])


def clean_scan(**options):
    rng = np.random.default_rng(0)
    return scan(SETUP, (VIEW,), rng, noise=0.0, dropout=0.0, **options)


def test_without_noise_every_point_is_on_the_skin_or_on_the_table():
    points = clean_scan()
    on_table = np.abs(points[:, 1] - SETUP.table) < 1e-9
    assert np.abs(radial_error(points[~on_table])).max() < 1e-6
    assert 0.2 < on_table.mean() < 0.8
    assert (radial_error(points[on_table]) > 0.0).all()


def test_only_what_faces_the_camera_is_seen():
    points = clean_scan()
    skin = points[np.abs(points[:, 1] - SETUP.table) > 1e-6]
    theta = np.arctan2(skin[:, 1], skin[:, 0])
    away = np.asarray(VIEW.eye) - skin
    facing = np.einsum("ij,ij->i", TORSO.normals(theta, skin[:, 2]), away)
    assert (facing > -1e-6).all()


def test_holes_are_empty():
    points = clean_scan()
    for theta, z, radius in SETUP.holes:
        middle = TORSO.skin(np.array(theta), np.array(z))
        assert np.linalg.norm(points - middle, axis=1).min() >= radius


def test_noise_lies_along_the_rays_with_its_deviation():
    rng = np.random.default_rng(1)
    points = scan(SETUP, (VIEW,), rng, noise=0.002, dropout=0.0)
    clean = clean_scan()
    assert len(points) == len(clean)
    ray = clean - VIEW.eye
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    along = np.einsum("ij,ij->i", points - clean, ray)
    assert points - clean == pytest.approx(along[:, None] * ray, abs=1e-12)
    assert along.std() == pytest.approx(0.002, rel=0.05)


def test_written_cloud_reads_back(tmp_path):
    points = clean_scan()
    write_cloud(points, tmp_path / "scan.ply")
    assert read_cloud(tmp_path / "scan.ply", unit="m") == pytest.approx(
        points, abs=1e-6
    )


def test_refuses_no_camera_and_one_that_sees_nothing():
    rng = np.random.default_rng(0)
    refuses(InputError, "at least one view", scan, SETUP, (), rng)
    with pytest.raises(InputError, match="sees nothing"):
        scan(SETUP, (View((0.0, 1.0, 0.15), target=(0.0, 2.0, 0.15)),), rng)


def test_a_depth_image_is_a_pinhole_camera_s():
    """Upper row first, x to the right, depths along the axis: it lies on the scan."""
    rng = np.random.default_rng(0)
    depth = depth_image(SETUP, VIEW, rng, noise=0.0, dropout=0.0)
    centre = (VIEW.pixels - 1) / 2
    row, column = np.nonzero(np.isfinite(depth))
    z = depth[row, column]
    slope = np.tan(VIEW.opening) / centre
    right, up, ahead = VIEW.axes()
    points = np.asarray(VIEW.eye) + np.outer(z, ahead)
    points += np.outer(z * (column - centre) * slope, right)
    points -= np.outer(z * (row - centre) * slope, up)
    on_table = np.abs(points[:, 1] - SETUP.table) < 1e-9
    assert np.abs(radial_error(points[~on_table])).max() < 1e-6
    assert len(points) == len(clean_scan())
