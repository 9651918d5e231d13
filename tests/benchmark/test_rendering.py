"""What the timing hands over; a time itself is never asserted."""

from __future__ import annotations

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.benchmark.rendering import time_rendering
from ttus_opt.errors import InputError
from ttus_opt.voxmap.field import PotentialField


def test_figures_are_complete_and_of_the_same_wrench() -> None:
    scene = small_scene("trilinear")
    values = np.random.default_rng(1).normal(size=scene.voxmap.grid.shape)
    field = PotentialField(scene.voxmap, values, "trilinear")
    trajectory = scene.trajectory
    figures = time_rendering(
        field, scene.shell, trajectory.rotation, trajectory.position, passes=2
    )
    assert figures.frames == 2 * len(trajectory)
    assert figures.contact_points == np.median(scene.rows.contact_points)
    assert figures.largest_difference < 1e-11
    assert figures.bytes_per_frame < 10
    for times in (figures.numpy, figures.loop, figures.renderer, figures.blending):
        assert 0 < times.median <= times.percentile_99 <= times.percentile_99_9
        assert times.percentile_99_9 <= times.longest


def test_needs_contact() -> None:
    scene = small_scene("trilinear")
    field = PotentialField(scene.voxmap, np.zeros(scene.voxmap.grid.shape), "trilinear")
    with pytest.raises(InputError, match="no pose touches"):
        time_rendering(
            field, scene.shell, np.eye(3)[None], np.array([[0, 0.5, 0.1]]), passes=1
        )
    with pytest.raises(InputError, match="at least one pass"):
        time_rendering(field, scene.shell, np.empty((0, 3, 3)), np.empty((0, 3)))
