"""The patient frame: rigid, written and read back, estimated from a scan."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.conftest import SHARED
from ttus_opt.arrays import Array
from ttus_opt.errors import GeometryError, InputError
from ttus_opt.scan import frame
from ttus_opt.scan.cloud import read_cloud
from ttus_opt.scan.extraction import extract_surface
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.supporting_plane import SupportingPlane

DATA = SHARED / "torso"


def rotation(rng: np.random.Generator) -> Array:
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[:, [1, 0, 2]]


def body(rng: np.random.Generator, *, upper: bool) -> Array:
    """An elliptic torso lying along z on y = 0, tapered, 50 cm long."""
    theta = (
        rng.uniform(0, np.pi, 30_000) if upper else rng.uniform(0, 2 * np.pi, 30_000)
    )
    z = rng.uniform(-0.25, 0.25, theta.size)
    width = 0.17 + 0.05 * z
    x, y = width * np.cos(theta), 0.11 + 0.11 * np.sin(theta)
    noise = 0.002 * rng.standard_normal((theta.size, 3))
    return np.stack([x, y, z], axis=1) + noise


def bed(rng: np.random.Generator) -> Array:
    x = rng.uniform(0.16, 0.4, 20_000) * rng.choice([-1, 1], 20_000)
    flat = 0.003 * rng.standard_normal(x.size)
    return np.stack([x, flat, rng.uniform(-0.3, 0.3, x.size)], axis=1)


def test_there_and_back() -> None:
    rng = np.random.default_rng(0)
    axis = Axis(rng.standard_normal(3), rotation(rng))
    points = rng.standard_normal((20, 3))
    np.testing.assert_allclose(axis.to_scan(axis.to_patient(points)), points)
    np.testing.assert_allclose(axis.to_patient(axis.origin[None]), 0, atol=1e-15)
    np.testing.assert_allclose(
        axis.to_scan(np.array([[0, 0, 1.0]]))[0], axis.origin + axis.rotation[:, 2]
    )


def test_attributes_round_trip_exactly() -> None:
    rng = np.random.default_rng(1)
    axis = Axis(rng.standard_normal(3), rotation(rng))
    again = Axis.from_attributes(axis.attributes())
    np.testing.assert_array_equal(again.origin, axis.origin)
    np.testing.assert_array_equal(again.rotation, axis.rotation)
    np.testing.assert_array_equal(Axis.from_attributes({}).rotation, np.eye(3))


@pytest.mark.parametrize(
    "matrix", [2 * np.eye(3), np.diag([1.0, 1, -1]), np.full((3, 3), np.nan)]
)
def test_no_rotation_is_refused(matrix: Array) -> None:
    with pytest.raises(InputError, match="not a rotation"):
        Axis(np.zeros(3), matrix)


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(InputError, match=r"origin \(3,\)"):
        Axis(np.zeros(2), np.eye(3))


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_found_on_a_bed_in_any_attitude(seed: int, upper: bool) -> None:
    rng = np.random.default_rng(seed)
    R, t = rotation(rng), rng.uniform(-1, 1, 3)
    cloud = np.concatenate([body(rng, upper=upper), bed(rng)]) @ R.T + t
    axis = Axis.from_cloud(cloud)
    x, _, z = (R.T @ axis.rotation).T  # the axes in the body's own frame
    assert abs(z[2]) > np.cos(np.radians(5))
    assert x[1] > np.cos(np.radians(2))  # away from the bed
    origin = R.T @ (axis.origin - t)
    np.testing.assert_allclose(origin, [0, 0.11, 0], atol=0.02)
    # the axis's sign follows the scan, not chance
    assert axis.rotation[np.argmax(np.abs(axis.rotation[:, 2])), 2] > 0


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10_000))
def test_found_without_a_bed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, t = rotation(rng), rng.uniform(-1, 1, 3)
    axis = Axis.from_cloud(body(rng, upper=False) @ R.T + t)
    x, _, z = (R.T @ axis.rotation).T
    assert abs(z[2]) > np.cos(np.radians(6))
    assert abs(x[1]) > np.cos(np.radians(12))  # along the shorter diameter
    origin = R.T @ (axis.origin - t)
    np.testing.assert_allclose(origin, [0, 0.11, 0], atol=0.03)


def test_one_sided_without_a_bed_looks_to_the_seen_side() -> None:
    rng = np.random.default_rng(0)
    axis = Axis.from_cloud(body(rng, upper=True))
    assert axis.rotation[1, 0] > 0.95
    assert abs(axis.origin[0]) < 0.02
    assert -0.15 < axis.origin[1] < 0.18  # below the ridge at 0.22


def test_real_scan() -> None:
    path = DATA / "realsense_male_m.pcd"
    if not path.exists():
        pytest.skip("realsense_male_m.pcd is not beside the checkout")
    axis = Axis.from_cloud(read_cloud(path))
    assert abs(axis.rotation[0, 2]) > np.cos(np.radians(8))  # the body lies along x
    assert axis.rotation[2, 0] > np.cos(np.radians(3))  # the table faces +z
    assert np.all((axis.origin > [0.5, -0.45, -0.15]) & (axis.origin < [0.7, -0.3, 0]))


def test_refusals() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="100 at least"):
        Axis.from_cloud(np.zeros((10, 3)))
    flat = bed(rng)
    stubs = np.array([[0.0, 0.1, 0]]) + 0.003 * rng.standard_normal((400, 3))
    with pytest.raises(GeometryError, match="points stand above the supporting"):
        Axis.from_cloud(np.concatenate([flat, stubs]))


def test_the_supporting_plane_is_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """It stays in the frame: extraction looks for none, and leaves the bed out."""
    rng = np.random.default_rng(0)
    cloud = np.concatenate([body(rng, upper=False), bed(rng)])
    axis, given = Axis.from_cloud(cloud), Axis.identity()
    plane = axis.support
    assert isinstance(plane, SupportingPlane)
    assert plane.normal[1] > 0.999
    expected = extract_surface(cloud, axis=axis, support=plane, n_theta=36, n_z=8)
    looks: list[Array] = []

    def looked(cloud: Array) -> SupportingPlane:
        looks.append(cloud)
        return plane

    monkeypatch.setattr(frame, "find_supporting_plane", looked)
    found = extract_surface(cloud, axis=axis, n_theta=36, n_z=8)
    np.testing.assert_array_equal(found.radius, expected.radius)
    assert not looks
    assert given.support == "unknown"
    assert given.supporting_plane(cloud) is plane  # a frame that was given looks
    assert len(looks) == 1
    assert Axis.from_cloud(body(rng, upper=False)).support is None
