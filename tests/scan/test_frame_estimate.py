"""The patient frame estimated from a scan, whatever its attitude."""

import contextlib

import numpy as np
import pytest
from hypothesis import example as example_of
from hypothesis import given, settings
from hypothesis import strategies as st

import ttus_opt as tt
from tests.kit import GeometryError, InputError, TtusWarning, refuses, shared_data
from ttus_opt import example
from ttus_opt.probe.even_sampling import sphere_lattice
from ttus_opt.scan import frame_estimate
from ttus_opt.scan.supporting_plane import SupportingPlane


def rotation(rng):
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[:, [1, 0, 2]]


def body(rng, *, upper, n=30_000):
    """A torso lying along z on y = 0: flat back, wider and deeper towards the head."""
    theta = rng.uniform(0, np.pi if upper else 2 * np.pi, n)
    z = rng.uniform(-0.25, 0.25, theta.size)
    width, half_depth = 0.17 + 0.05 * z, 0.11 + 0.03 * z
    s = np.sin(theta)
    rise = np.where(s > 0, s, -np.sqrt(np.abs(s)))
    x, y = width * np.cos(theta), half_depth * (1 + rise)
    noise = 0.002 * rng.standard_normal((theta.size, 3))
    return np.stack([x, y, z], axis=1) + noise


def bed(rng, n=20_000):
    x = rng.uniform(0.16, 0.4, n) * rng.choice([-1, 1], n)
    flat = 0.003 * rng.standard_normal(x.size)
    return np.stack([x, flat, rng.uniform(-0.3, 0.3, x.size)], axis=1)


@pytest.mark.slow
@settings(max_examples=8)
@given(st.integers(0, 10_000), st.booleans())
def test_found_on_a_bed_in_any_attitude(seed, upper):
    rng = np.random.default_rng(seed)
    R, t = rotation(rng), rng.uniform(-1, 1, 3)
    cloud = np.concatenate([body(rng, upper=upper), bed(rng)]) @ R.T + t
    axis = tt.Axis.from_cloud(cloud)
    x, y, z = (R.T @ axis.rotation).T  # the axes in the body's own frame
    assert z[2] > np.cos(np.radians(5))  # towards the head
    assert y[1] > np.cos(np.radians(2))  # away from the bed
    np.testing.assert_allclose(np.cross(x, y), z, atol=1e-12)
    origin = R.T @ (axis.origin - t)
    np.testing.assert_allclose(origin, [0, 0.11, 0], atol=0.02)


@pytest.mark.slow
def test_the_user_says_how_the_patient_lies():
    rng = np.random.default_rng(3)
    cloud = np.concatenate([body(rng, upper=False), bed(rng)])
    found = tt.Axis.from_cloud(cloud).rotation
    turned = found * [-1, 1, -1]
    np.testing.assert_array_equal(tt.Axis.from_cloud(cloud, flip=True).rotation, turned)
    feet_first = tt.Axis.from_cloud(cloud, head=[0.4, 0.0, -1.0])
    np.testing.assert_array_equal(feet_first.rotation, turned)
    assert feet_first.origin.tolist() == tt.Axis.from_cloud(cloud).origin.tolist()
    prone = tt.Axis.from_cloud(cloud, prone=True, head=[0, 0, 1])
    np.testing.assert_array_equal(prone.rotation, found * [-1, -1, 1])
    with pytest.raises(GeometryError, match="90° away from the body's axis"):
        tt.Axis.from_cloud(cloud, head=[1, 0, 0])
    refuses(InputError, "must not be zero", tt.Axis.from_cloud, cloud, head=[0, 0, 0])
    refuses(InputError, "a direction x,y,z", tt.Axis.from_cloud, cloud, head=[0, 1])
    nowhere = [np.nan, 0, 0]
    refuses(InputError, "camera's place", tt.Axis.from_cloud, cloud, camera=nowhere)


def test_what_the_scan_hardly_tells_is_said(monkeypatch):
    no_bed(monkeypatch)
    rng = np.random.default_rng(4)
    theta, z = rng.uniform(0, 2 * np.pi, 20_000), rng.uniform(-0.25, 0.25, 20_000)
    tube = np.stack([0.17 * np.cos(theta), 0.11 * np.sin(theta), z], axis=1)
    with pytest.warns(TtusWarning) as told:
        tt.Axis.from_cloud(tube)
    messages = [str(w.message) for w in told]
    assert ["which side is the front" in m for m in messages] == [True, False]
    assert ["which end is the head" in m for m in messages] == [False, True]
    assert {w.filename for w in told} == {__file__}


def turned_around(cloud, count):
    """Largest difference of the frames of a scan turned and shuffled [°, m]."""
    rng = np.random.default_rng(7)
    own, angles, distances = tt.Axis.from_cloud(cloud), [], []
    for _ in range(count):
        R, t = rotation(rng), rng.uniform(-1, 1, 3)
        other = tt.Axis.from_cloud(rng.permutation(cloud) @ R.T + t)
        off = own.rotation.T @ R.T @ other.rotation
        angles.append(np.degrees(np.arccos(np.clip(np.trace(off) / 2 - 0.5, -1, 1))))
        distances.append(float(np.linalg.norm(R.T @ (other.origin - t) - own.origin)))
    return max(angles), max(distances)


def test_turning_the_examples_scan_keeps_its_frame():
    cloud = tt.read_cloud(example.path("scan.ply"))
    truth = tt.Surface.load(example.path("surface.nc")).axis
    off = truth.rotation.T @ tt.Axis.from_cloud(cloud).rotation
    assert np.trace(off) > 1 + 2 * np.cos(np.radians(0.5))
    angle, distance = turned_around(cloud, 1)
    assert angle < 0.5
    assert distance < 2e-3


@pytest.mark.slow
def test_head_and_front_of_a_real_torso():
    """A CT's skin: x to the right, y to the front and z to the head (RAS)."""
    path = shared_data("torso/ct_skin_mm.ply")
    cloud = tt.read_cloud(path, unit="mm")
    axis = tt.Axis.from_cloud(cloud)
    assert np.diag(axis.rotation).min() > np.cos(np.radians(8))
    angle, distance = turned_around(cloud, 4)
    assert angle < 3.0  # a belly: its long axis is known no better
    assert distance < 5e-3


@pytest.mark.slow
@settings(max_examples=8)
@given(st.integers(0, 10_000))
@example_of(438)  # looks like one view from the scan's origin
def test_found_without_a_bed(seed):
    rng = np.random.default_rng(seed)
    R, t = rotation(rng), rng.uniform(-1, 1, 3)
    axis = tt.Axis.from_cloud(body(rng, upper=False) @ R.T + t)
    _, y, z = (R.T @ axis.rotation).T
    assert z[2] > np.cos(np.radians(6))
    assert y[1] > np.cos(np.radians(12))  # along the shorter diameter, off the flat
    origin = R.T @ (axis.origin - t)
    np.testing.assert_allclose(origin, [0, 0.11, 0], atol=0.03)


def no_bed(monkeypatch):
    """No search for one: that none is found has tests of its own, and takes long."""
    monkeypatch.setattr(frame_estimate, "find_supporting_plane", lambda *_, **__: None)


def test_one_sided_without_a_bed_looks_to_the_seen_side(monkeypatch):
    no_bed(monkeypatch)
    rng = np.random.default_rng(0)
    axis = tt.Axis.from_cloud(body(rng, upper=True, n=8000))
    assert axis.rotation[1, 1] > 0.95
    assert abs(axis.origin[0]) < 0.02
    assert -0.15 < axis.origin[1] < 0.18  # below the ridge at 0.22


def test_real_scan():
    path = shared_data("torso/realsense_male_m.pcd")
    with pytest.warns(
        TtusWarning, match="which end is the head"
    ):  # as high at both ends
        axis = tt.Axis.from_cloud(tt.read_cloud(path))
    assert abs(axis.rotation[0, 2]) > np.cos(np.radians(8))  # the body lies along x
    assert axis.rotation[2, 1] > np.cos(np.radians(3))  # the table faces +z
    assert np.all((axis.origin > [0.5, -0.45, -0.15]) & (axis.origin < [0.7, -0.3, 0]))


def test_refusals():
    rng = np.random.default_rng(0)
    refuses(InputError, "100 at least", tt.Axis.from_cloud, np.zeros((10, 3)))
    flat = bed(rng)
    stubs = np.array([[0.0, 0.1, 0]]) + 0.003 * rng.standard_normal((400, 3))
    with pytest.raises(GeometryError, match="points stand above the supporting"):
        tt.Axis.from_cloud(np.concatenate([flat, stubs]))


def tube(n_around, n_along, share=1.0):
    """A tube of 0.15 m about z, 0.5 m long, or a part of its round, and its normals."""
    turn = share * 2 * np.pi * (np.arange(n_around) + 0.5) / n_around
    theta, z = np.meshgrid(turn, np.linspace(-0.25, 0.25, n_along), indexing="ij")
    across = np.stack([np.cos(theta), np.sin(theta), np.zeros_like(z)], axis=-1)
    points = 0.15 * across + z[..., None] * np.array([0.0, 0.0, 1.0])
    return points.reshape(-1, 3), across.reshape(-1, 3)


def test_the_axis_is_exact_wherever_the_candidates_stand():
    """Caps over the ends face along it and have as many points: they are cut off."""
    points, normals = tube(40, 20)
    caps = np.array([[0.05, 0.05, 0.25], [-0.05, 0.0, -0.25]]).repeat(400, axis=0)
    along = np.array([[0.0, 0.0, 1.0]]).repeat(800, axis=0)
    rng = np.random.default_rng(0)
    for _ in range(5):
        R = rotation(rng)
        found = frame_estimate._along(
            np.concatenate([points, caps]) @ R.T,
            np.concatenate([normals, along]) @ R.T,
            sphere_lattice(2000)[:1000],
            np.eye(3),
        )
        assert abs(found @ R[:, 2]) > 1.0 - 1e-12


def test_trial_directions_leave_no_gap():
    """No direction is further from one of 4000 than evenly spread ones would be."""
    trials = sphere_lattice(8000)[:4000]
    np.testing.assert_allclose(np.linalg.norm(trials, axis=1), 1.0)
    rng = np.random.default_rng(1)
    random = rng.normal(size=(500, 3))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    nearest = np.degrees(np.arccos(np.abs(random @ trials.T).max(axis=1).clip(max=1)))
    cell = np.degrees(np.sqrt(2 * np.pi / 4000))  # edge of a square of the same area
    assert nearest.max() < cell


def test_density_does_not_count():
    """Means of cells, by a dictionary; a cell with few points is stray."""
    rng = np.random.default_rng(2)
    points = np.concatenate(
        [rng.uniform(0.0, 0.05, (3000, 3)), [[0.2, 0.2, 0.2]], np.zeros((1, 3))]
    )
    cells = {}
    for point in points:
        cells.setdefault(tuple((point // 0.012).astype(int)), []).append(point)
    least = np.median([len(own) for own in cells.values()]) / 10
    means = [np.mean(own, axis=0) for own in cells.values() if len(own) >= least]
    found = frame_estimate._thinned(points)
    assert len(found) == len(means) < len(cells)
    np.testing.assert_allclose(
        found[np.lexsort(found.T)], np.array(means)[np.lexsort(np.array(means).T)]
    )


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_a_tube_has_its_centre_wherever_it_was_seen_from(share):
    points, normals = tube(60, 20, share)
    rng = np.random.default_rng(3)
    R, t = rotation(rng), rng.uniform(-1, 1, 3)
    warns = pytest.warns(TtusWarning, match="which side is the front")
    with warns if share == 1.0 else contextlib.nullcontext():
        origin, upward, z = frame_estimate._free_frame(
            points @ R.T + t, normals @ R.T, None, stated=False
        )
    np.testing.assert_allclose(origin, t, atol=1e-9)
    assert abs(z @ R[:, 2]) > 1.0 - 1e-12
    assert abs(upward @ z) < 1e-9
    if share < 1.0:  # upward to the middle of what was seen
        seen = R @ [np.cos(share * np.pi), np.sin(share * np.pi), 0.0]
        np.testing.assert_allclose(upward, seen, atol=1e-9)


def test_no_round_body_is_refused():
    points, _ = tube(60, 20)
    plane = points * [1.0, 0.0, 1.0]
    with pytest.raises(GeometryError, match="not round"):
        frame_estimate._free_frame(
            plane, np.tile([0.0, 1.0, 0.0], (len(plane), 1)), None, stated=False
        )


def test_on_a_plane_the_origin_is_half_way_up():
    """A half tube on a plane that is tilted: by its height, width and length."""
    points, normals = tube(200, 60, 0.5)
    R, offset = rotation(np.random.default_rng(4)), 0.3
    up = R[:, 1]
    plane = SupportingPlane(up, offset, 0.005)
    cloud = points @ R.T + offset * up
    origin, upward, z = frame_estimate._supported_frame(cloud, normals @ R.T, plane)
    np.testing.assert_allclose(upward, up)
    assert abs(z @ R[:, 2]) > 1.0 - 1e-12
    np.testing.assert_allclose(origin, (offset + 0.075) * up, atol=1e-3)
