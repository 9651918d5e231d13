"""Patch, sliding and regions against plain numpy."""

from dataclasses import replace

import numpy as np

from tests.contact.test_friction import SHELL, VOXMAP, slide
from ttus_opt.contact.friction import Sliding


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
