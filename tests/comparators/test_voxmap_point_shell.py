"""Voxels of two bits and tangent-plane forces against plain loops."""

import numpy as np
from scipy.spatial.transform import Rotation

from tests.comparators.contacts import made as on_torso
from tests.comparators.recordings import facing, fitted
from tests.kit import torso
from ttus_opt.comparators.voxmap_point_shell import (
    FREE,
    INTERIOR,
    SURFACE,
    VoxmapPointShell,
)


def test_voxels_hold_two_bits_and_interior_never_meets_free():
    made = on_torso(VoxmapPointShell, edge=0.005)
    voxels = made.voxels
    assert set(np.unique(voxels)) == {FREE, INTERIOR, SURFACE}
    for axis in range(3):
        pairs = np.stack([np.delete(voxels, -1, axis), np.delete(voxels, 0, axis)])
        assert not ((pairs.min(axis=0) == FREE) & (pairs.max(axis=0) == INTERIOR)).any()


def test_tangent_planes_are_those_of_a_plain_loop():
    made = on_torso(VoxmapPointShell, edge=0.004)
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


def test_a_step_over_a_voxel_face_changes_the_force_by_one_edge_at_most():
    made = fitted("voxmap_point_shell")
    path = np.linspace(0.0, 0.006, 300)
    force = []
    for z in path:
        R, at = facing(torso(), 1.3, 0.1, 0.004)
        force.append(made.render(R, at + np.array([0.0, 0.0, z])).force)
    jump = np.abs(np.diff(force, axis=0)).max()
    most = made.stiffness * made.edge * made.shell.areas.max()
    # 20 µm of sliding, and a handful of points that cross a face in one step
    assert 0.0 < jump < 8.0 * most


def test_a_probe_beside_the_voxels_touches_nothing():
    """Wholly, or in part beyond their edge."""
    made = on_torso(VoxmapPointShell, edge=0.005)
    edge = -made.corner[0]
    for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        for far in (edge + 0.014, 1.0):
            at = np.array([0.0, 0.0, 0.1])
            at[axis] = sign * far
            unit, points = made._unit_wrench(np.eye(3), at)
            inside = (made.shell.points + at)[:, :2]
            assert far == 1.0 or (np.abs(inside).max(axis=1) < edge).any()
            assert points == 0 and not unit.any()


def test_beyond_its_ends_the_patient_continues():
    made = on_torso(VoxmapPointShell, edge=0.005)
    heights = made.corner[2] + made.edge * (np.array(made.voxels.shape) - 1)[2]
    R, at = facing(torso(), 1.1, 0.1, 0.007)
    for end, way in ((made.corner[2], -1.0), (heights, 1.0)):
        wrenches = []
        for far in (0.03, 0.2):
            at[2] = end + way * far
            unit, points = made._unit_wrench(R, at)
            wrenches.append([*unit, points])
        assert wrenches[0][-1] > 0
        np.testing.assert_allclose(*wrenches, atol=1e-15)
