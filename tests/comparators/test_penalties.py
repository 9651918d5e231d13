"""The comparators of one stiffness against blocks, spheres and plain loops."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.comparators.recordings import facing, fitted
from tests.comparators.walls import BLOCK, block, pressed, wall
from tests.conftest import ellipsoid, torso
from ttus_opt.comparators.base import OneStiffness
from ttus_opt.comparators.ellipsoid_torso import EllipsoidTorso, fitted_ellipsoid
from ttus_opt.comparators.pressure_field import PressureField, integrated
from ttus_opt.comparators.proxy_cloud import ProxyCloud
from ttus_opt.comparators.proxy_six_dof import ProxySixDof, least_motion
from ttus_opt.comparators.signed_distance import SignedDistance
from ttus_opt.comparators.voxmap_point_shell import (
    FREE,
    INTERIOR,
    SURFACE,
    VoxmapPointShell,
)
from ttus_opt.probe.point_shell import PointShell

AREA, DEPTH = BLOCK[0] * BLOCK[1], 0.002


def test_signed_distance_gives_a_block_area_times_depth() -> None:
    made = SignedDistance(surface=wall(), shell=block())
    unit, _ = made._unit_wrench(*pressed(DEPTH))
    assert unit[0] == pytest.approx(AREA * DEPTH, rel=0.02)
    # opposite sides of the block cancel to the evenness of its points
    np.testing.assert_allclose(unit[1:], 0.0, atol=0.03 * unit[0])


def test_pressure_field_gives_a_rigid_block_area_times_depth() -> None:
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(8, 3)
    shell = PointShell(
        0.5 * signs * BLOCK, -signs / 3.0**0.5, np.full(8, 1e-4), np.zeros(3)
    )
    unit, touching = PressureField(surface=wall(), shell=shell)._unit_wrench(
        *pressed(DEPTH)
    )
    assert touching == 4
    # the wall falls off by 0.006 mm towards the block's long edges
    np.testing.assert_allclose(
        unit[:3], [AREA * DEPTH, 0.0, 0.0], atol=0.005 * AREA * DEPTH
    )
    np.testing.assert_allclose(unit[3:], 0.0, atol=1e-10)


@pytest.mark.parametrize("kind", [SignedDistance, PressureField])
def test_a_pressed_ball_displaces_its_cap(kind: type[OneStiffness]) -> None:
    """Pressure k d on a rigid body is k times the volume below the surface (Gauss)."""
    radius = 0.02
    made = kind(surface=wall(), shell=PointShell.sphere(radius, n_points=1200))
    for depth in (0.003, 0.008):
        unit, _ = made._unit_wrench(*pressed(depth, half=radius))
        cap = np.pi * depth**2 * (radius - depth / 3.0)
        assert unit[0] == pytest.approx(cap, rel=0.03)
        np.testing.assert_allclose(unit[1:3], 0.0, atol=0.02 * cap)
        np.testing.assert_allclose(unit[3:], 0.0, atol=0.02 * cap * radius)


def test_pressures_are_equal_on_the_contact_surface_like_springs_in_series() -> None:
    made = PressureField(surface=wall(), shell=block(), ratio=3.0)
    arm, depth = made._contact_surface(*pressed(DEPTH))
    R, _ = pressed(DEPTH)
    shift = np.linalg.norm(arm - block().points @ R.T, axis=1)
    np.testing.assert_allclose(np.abs(depth), 3.0 * shift, atol=1e-9)
    face = block().normals[:, 2] > 0.99  # below the block: its inward normal is up
    np.testing.assert_allclose(depth[face], 0.75 * DEPTH, rtol=0.02)


def test_triangles_are_integrated_as_by_many_small_ones() -> None:
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(6, 3, 3))
    pressure = rng.normal(size=(6, 3))
    n = 400
    u, v = (np.stack(np.meshgrid(np.arange(n), np.arange(n))).reshape(2, -1) + 0.5) / n
    u, v = np.where(u + v > 1.0, (1.0 - u, 1.0 - v), (u, v))
    shares = np.stack([1.0 - u - v, u, v])
    expected = np.zeros(6)
    for x, p in zip(corners, pressure, strict=True):
        value = np.maximum(p @ shares, 0.0)
        into = -0.5 * np.cross(x[1] - x[0], x[2] - x[0])
        force = value[:, None] * into / len(u)
        expected[:3] += force.sum(axis=0)
        expected[3:] += np.cross((x.T @ shares).T, force).sum(axis=0)
    found = integrated(
        corners.reshape(-1, 3), np.arange(18).reshape(6, 3), pressure.ravel()
    )
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def test_voxels_hold_two_bits_and_interior_never_meets_free() -> None:
    made = VoxmapPointShell(surface=torso(), shell=ellipsoid(), edge=0.005)
    voxels = made.voxels
    assert set(np.unique(voxels)) == {FREE, INTERIOR, SURFACE}
    for axis in range(3):
        pairs = np.stack([np.delete(voxels, -1, axis), np.delete(voxels, 0, axis)])
        assert not ((pairs.min(axis=0) == FREE) & (pairs.max(axis=0) == INTERIOR)).any()


def test_tangent_planes_are_those_of_a_plain_loop() -> None:
    made = VoxmapPointShell(surface=torso(), shell=ellipsoid(), edge=0.004)
    R, at = facing(torso(), 1.1, 0.1, 0.007)
    R = R @ Rotation.from_rotvec([0.5, 0.4, 0.0]).as_matrix()
    surface = np.argwhere(made.voxels == SURFACE)
    low, high = np.zeros(6), np.zeros(6)
    for point, normal, area in zip(
        made.shell.points, made.shell.normals, made.shell.areas, strict=True
    ):
        x, n = R @ point + at, R @ normal
        voxel = np.round((x - made.corner) / made.edge).astype(int)
        if made.voxels[tuple(voxel)] == FREE:
            continue
        squares = ((surface - voxel) ** 2).sum(axis=1)
        # several voxels may be equally near: any of their planes will do
        planes = made.corner + made.edge * surface[squares == squares.min()]
        pushes = area * np.maximum((planes - x) @ n, 0.0)
        wrench = pushes[:, None] * np.concatenate([n, np.cross(x - at, n)])
        low += wrench.min(axis=0)
        high += wrench.max(axis=0)
    unit, _ = made._unit_wrench(R, at)
    assert (unit >= low - 1e-15).all()
    assert (unit <= high + 1e-15).all()
    assert np.linalg.norm(high - low) < 0.3 * np.linalg.norm(high)


def test_a_step_over_a_voxel_face_changes_the_force_by_one_edge_at_most() -> None:
    made = fitted("voxmap_point_shell")
    assert isinstance(made, VoxmapPointShell)
    path = np.linspace(0.0, 0.006, 300)
    force = []
    for z in path:
        R, at = facing(torso(), 1.3, 0.1, 0.004)
        force.append(made.render(R, at + np.array([0.0, 0.0, z])).force)
    jump = np.abs(np.diff(force, axis=0)).max()
    most = made.stiffness * made.edge * made.shell.areas.max()
    # 20 µm of sliding, and a handful of points that cross a face in one step
    assert 0.0 < jump < 8.0 * most


def test_the_ellipsoid_that_is_there_is_found() -> None:
    rng = np.random.default_rng(5)
    unit = rng.normal(size=(800, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    turn = Rotation.from_rotvec([0.1, 0.2, -0.1]).as_matrix()
    semi = np.array([0.12, 0.09, 0.3])
    cloud = (unit * semi) @ turn.T + [0.01, -0.02, 0.1]
    centre, found, axes = fitted_ellipsoid(cloud)
    np.testing.assert_allclose(centre, [0.01, -0.02, 0.1], atol=1e-6)
    shape = axes @ np.diag(found**2) @ axes.T
    np.testing.assert_allclose(shape, turn @ np.diag(semi**2) @ turn.T, atol=1e-7)


def test_depth_below_a_sphere_is_the_difference_of_radii() -> None:
    made = EllipsoidTorso(surface=torso(), shell=ellipsoid())
    made.centre, made.semi_axes, made.axes = np.zeros(3), np.full(3, 0.1), np.eye(3)
    points = np.array([[0.09, 0.0, 0.0], [0.03, 0.04, 0.0], [0.0, 0.11, 0.02]])
    np.testing.assert_allclose(made.depth(points), 0.1 - np.linalg.norm(points, axis=1))
    assert np.isfinite(made.depth(np.zeros((1, 3)))).all()


def test_the_proxy_on_a_flat_cloud_is_above_the_tip() -> None:
    y, z = np.meshgrid(np.arange(-0.05, 0.05, 0.004), np.arange(-0.05, 0.05, 0.004))
    cloud = np.stack([np.full(y.size, 9.0), y.ravel(), z.ravel()], axis=1)
    made = ProxyCloud(
        surface=wall(), shell=block(), cloud=cloud, tip=(0.001, 0.002, -0.01)
    )
    R, at = pressed(0.003)
    unit, touching = made._unit_wrench(R, at)
    assert touching == 1
    np.testing.assert_allclose(unit[:3], [0.003, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(unit[3:], np.cross(R @ made.tip, unit[:3]), atol=1e-12)
    assert made._unit_wrench(*pressed(-0.001))[1] == 0


def test_six_dof_lifts_a_block_straight_out_of_a_half_space() -> None:
    made = ProxySixDof(surface=wall(), shell=block(400))
    unit, _ = made._unit_wrench(*pressed(0.003))
    np.testing.assert_allclose(unit[0], 0.003, rtol=0.02)
    np.testing.assert_allclose(unit[1:3], 0.0, atol=1e-4)


def test_six_dof_leaves_no_point_below_the_surface() -> None:
    made = fitted_six_dof()
    R, at = facing(torso(), 1.4, 0.1, 0.008)
    R = R @ Rotation.from_rotvec([0.3, 0.2, 0.0]).as_matrix()
    unit, _ = made._unit_wrench(R, at)
    turn = Rotation.from_rotvec(unit[3:] / made.shell.rms_radius**2).as_matrix()
    points = made.shell.points @ (turn @ R).T + at + unit[:3]
    depth, _ = made.geometry.surface.depth(points)
    assert depth.max() < 1e-4
    assert np.sort(depth)[-3:].min() > -1e-3  # and touches


def fitted_six_dof() -> ProxySixDof:
    return ProxySixDof(surface=torso(), shell=ellipsoid())


def test_the_least_motion_is_that_of_a_general_solver() -> None:
    from scipy.optimize import minimize

    rng = np.random.default_rng(2)
    for _ in range(5):
        rows = rng.normal(size=(8, 6)) + np.eye(6)[0]
        least = rng.uniform(-0.5, 1.0, 8)
        found = minimize(
            lambda x: 0.5 * x @ x,
            np.zeros(6),
            jac=lambda x: x,
            constraints={"type": "ineq", "fun": lambda x, r=rows, b=least: r @ x - b},
            method="SLSQP",
            options={"ftol": 1e-12, "maxiter": 500},
        )
        np.testing.assert_allclose(least_motion(rows, least), found.x, atol=1e-6)


def test_contradictions_give_way_like_springs() -> None:
    rows = np.array([[1.0, 0.0], [-1.0, 0.0]])
    motion = least_motion(rows, np.array([2.0, 1.0]))
    # min ½x² + ½((2 − x)² + (1 + x)²)/SOFT²
    soft = 0.3**-2
    assert motion[0] == pytest.approx(soft / (1.0 + 2.0 * soft), rel=1e-6)
