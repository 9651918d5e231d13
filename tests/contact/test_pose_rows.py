"""Rows of moved poses against those of scenes, and their derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.contact.point_drag import point_drag_rows
from ttus_opt.contact.pose_rows import PoseRows
from ttus_opt.contact.rows import contact_rows
from ttus_opt.probe.tracker_noise import TrackerNoise


@pytest.mark.parametrize("sampling", ["trilinear", "contact-size"])
def test_rows_at_the_recorded_poses_are_those_of_contact_and_drag(
    sampling: str,
) -> None:
    scene = small_scene(sampling)
    own = scene.trajectory
    at = scene.voxmap, scene.shell, own
    drag = point_drag_rows(*at, sampling=sampling).force
    for friction in (0.0, 0.3):
        rows = PoseRows.of(*at, sampling, friction)
        found = rows.at(own.rotation, own.position)
        assert abs(found - (scene.N - friction * drag)).max() < 1e-14


def test_drag_keeps_its_sense_at_moved_poses() -> None:
    """The motion is that of the recording, not that of the moved poses."""
    scene = small_scene("trilinear")
    own = scene.trajectory
    rows = PoseRows.of(scene.voxmap, scene.shell, own, "trilinear", 0.3)
    moved = np.random.default_rng(0).normal(0.0, 1e-3, own.position.shape)
    there = own.rotation, own.position + moved
    pressed = contact_rows(scene.voxmap, scene.shell, *there, sampling="trilinear").N
    elsewhere = replace(own, position=there[1])
    elsewhere.__dict__["_twist"] = own.twist()
    drag = point_drag_rows(scene.voxmap, scene.shell, elsewhere).force
    assert abs(rows.at(*there) - (pressed - 0.3 * drag)).max() < 1e-12


def test_derivatives_are_those_of_the_force() -> None:
    """By a step a hundred times smaller, for a field without corners."""
    scene = small_scene("trilinear", (9, 20, 10), 12)
    own = scene.trajectory
    rows = PoseRows.of(scene.voxmap, scene.shell, own, "trilinear", 0.2)
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
