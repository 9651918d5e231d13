"""Rows of moved poses against those of scenes, and their derivatives."""

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.contact.pose_rows import PoseRows
from ttus_opt.probe.tracker_noise import TrackerNoise


@pytest.mark.parametrize("sampling", ["trilinear", "contact-size"])
def test_rows_at_the_recorded_poses_are_those_of_contact(sampling):
    scene = small_scene(sampling)
    own = scene.trajectory
    rows = PoseRows(scene.voxmap, scene.shell, sampling)
    assert abs(rows.at(own.rotation, own.position) - scene.N).max() < 1e-14


def test_derivatives_are_those_of_the_force():
    """By a step a hundred times smaller, for a field without corners."""
    scene = small_scene("trilinear", (9, 20, 10), 12)
    own = scene.trajectory
    rows = PoseRows(scene.voxmap, scene.shell, "trilinear")
    p = scene.laplace.solve(scene.b)
    noise, fine = TrackerNoise(1e-4, 2e-3), TrackerNoise(1e-6, 2e-5)
    found = rows.derivatives(own.rotation, own.position, noise)
    assert len(found) == 6
    for j in range(6):
        xi = np.zeros((len(own), 6))
        xi[:, j] = 1.0
        ahead = rows.at(*fine.moved(own.rotation, own.position, xi)) @ p
        expected = 100.0 * (ahead - rows.at(own.rotation, own.position) @ p)
        error = np.linalg.norm(found[j] @ p - expected)
        assert error < 0.05 * np.linalg.norm(expected)
