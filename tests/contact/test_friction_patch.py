"""Patch, sliding and regions against plain numpy."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.contact.test_friction import SHELL, VOXMAP, slide
from ttus_opt.contact.friction import Sliding
from ttus_opt.probe.point_shell import PointShell


def test_the_patch_is_weighted_by_area_and_depth():
    """Against plain numpy, for a probe that leans and whose points are uneven."""
    rng = np.random.default_rng(8)
    probe = PointShell.ellipsoid(semi_axes=(0.03, 0.0125, 0.018), n_points=600)
    uneven = replace(probe, areas=probe.areas * rng.uniform(0.2, 5.0, 600))
    lean = Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()
    still = slide(np.zeros(3))
    pose = replace(still, rotation=np.repeat(lean[None], 9, axis=0))
    seen = Sliding.of(VOXMAP, uneven, pose)
    points = uneven.points @ lean.T + pose.position[0]
    depth = np.maximum(0.09 - np.hypot(points[:, 0], points[:, 1]), 0.0)
    weight = uneven.areas * depth
    normal = weight @ (uneven.normals @ lean.T)
    np.testing.assert_allclose(seen.normal[0], normal / np.linalg.norm(normal))
    np.testing.assert_allclose(seen.position[0], weight @ points / weight.sum())
    flat = uneven.areas * (depth > 0)  # what neither depth nor area would give
    assert np.abs(flat @ points / flat.sum() - seen.position[0]).max() > 2e-4


def test_a_turning_probe_slides_about_its_own_reference():
    """The patch moves with the probe's material there, whatever its frame's origin."""
    shift = np.array([0.02, -0.03, 0.05])
    held = replace(
        SHELL, points=SHELL.points + shift, reference=SHELL.reference + shift
    )
    trajectory = slide(np.array([0.0, 0.02, -0.01]), spin=np.array([0.0, 0.4, 0.7]))
    origin = trajectory.position - trajectory.rotation @ shift
    moved = replace(trajectory, position=origin)
    for where in ("contact", "reference"):
        first = Sliding.of(VOXMAP, SHELL, trajectory, where, np.array([1.0, 0, 0]))
        second = Sliding.of(VOXMAP, held, moved, where, np.array([1.0, 0, 0]))
        # the same body: inner frames, where velocities are central differences
        np.testing.assert_allclose(
            first.velocity[1:-1], second.velocity[1:-1], atol=2e-5
        )
        assert np.linalg.norm(first.velocity, axis=1).min() > 0.01


def test_bands_and_sectors_are_counted_from_zero():
    """Patches just below and just above each limit between regions."""
    grid, edge = VOXMAP.grid, 1e-9
    length = grid.z_max - grid.z_min
    angles = 2 * np.pi * np.array([0.0, 0.25 - edge, 0.25 + edge, 0.5 + edge, 1 - edge])
    heights = grid.z_min + length * np.array([0, 0.2 - edge, 0.2 + edge, 0.8, 1.0])
    heights[3] += edge
    places = np.stack([np.cos(angles), np.sin(angles), heights], axis=1)
    sliding = replace(
        Sliding.of(VOXMAP, SHELL, slide(np.zeros(3), n=5)), position=places
    )
    region = sliding.regions(4, 5, VOXMAP)
    np.testing.assert_array_equal(region // 5, [0, 0, 1, 2, 3])  # sector
    np.testing.assert_array_equal(region % 5, [0, 0, 1, 4, 4])  # band
