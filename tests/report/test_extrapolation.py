"""Errors near and far from the fitted places, light and deep, by hand."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import FileError, small_scene
from ttus_opt.comparators.contact_geometry import ContactGeometry
from ttus_opt.report.extrapolation import (
    CELL,
    CHUNK,
    MOST_CELLS,
    Contacts,
    FittedContacts,
    bins,
    by_distance_and_depth,
)
from ttus_opt.report.metrics import as_rendered, compare

RADIUS, BALL = 0.1, 0.02


def cylinder():
    return tt.Surface.from_radius(np.full((36, 21), RADIUS), np.linspace(0.0, 0.2, 21))


def presses(angle, depth):
    """A ball pressed along the radius at half the height."""
    r, n = RADIUS + BALL - depth, len(depth)
    at = np.c_[r * np.cos(angle), r * np.sin(angle), np.full(n, 0.1)]
    force = np.zeros((n, 3))
    return tt.Trajectory(
        0.1 * np.arange(n), at, np.tile(np.eye(3), (n, 1, 1)), force, force
    )


@pytest.mark.slow
def test_depth_and_place_of_a_ball_on_a_cylinder():
    n = CHUNK + 50  # more than is in memory at once
    angle, depth = np.linspace(0.3, 5.0, n), np.linspace(-0.002, 0.008, n)
    shell = tt.PointShell.sphere(BALL, 3000)
    found = Contacts.of(cylinder(), shell, presses(angle, depth))
    np.testing.assert_allclose(found.depth, np.maximum(depth, 0.0), atol=2e-4)
    on = depth > 1e-3
    place = RADIUS * np.c_[np.cos(angle), np.sin(angle), np.ones(n)]
    place[:, 2] = 0.1
    assert np.linalg.norm(found.place - place, axis=1)[on].max() < 1e-3
    assert not found.depth[depth < 0.0].any()


def test_a_probe_beyond_the_ends_touches_nothing():
    """Where a robot waits, lower than the skin: it was no place, and is no frame."""
    poses = presses(np.zeros(5), np.full(5, 0.01))
    poses.position[:, 2] = 0.1, 0.3, -0.2, 0.19, 0.23
    found = Contacts.of(cylinder(), tt.PointShell.sphere(BALL, 800), poses)
    np.testing.assert_array_equal(found.depth > 0.0, [1, 0, 0, 1, 0])
    kept = FittedContacts.of(found)
    assert kept is not None
    np.testing.assert_allclose(kept.cells[:, 2] * CELL, [0.1, 0.188], atol=CELL)


def test_distances_of_a_recording_from_what_was_fitted():
    """Along a cylinder, at chords of known arcs."""
    shell, surface = tt.PointShell.sphere(BALL, 800), cylinder()
    one = presses(np.zeros(3), np.array([0.002, 0.008, 0.004]))
    fitted = FittedContacts.of(Contacts.of(surface, shell, one))
    assert fitted is not None
    arcs = np.array([0.0, 0.015, 0.03, 0.048, 0.07, 0.09, 0.12, 0.2, 0.3])
    unseen = presses(arcs / RADIUS, np.full(len(arcs), 0.006))
    found = Contacts.of(surface, shell, unseen)
    chords = 2.0 * RADIUS * np.sin(arcs / (2.0 * RADIUS))
    away = FittedContacts.from_text(fitted.text).distance(found.place)
    np.testing.assert_allclose(away, chords, atol=CELL)
    judged = compare(unseen, as_rendered(np.zeros((len(arcs), 6))))
    far, _ = by_distance_and_depth(fitted, found, judged)
    assert [one.frames for one in far] == [2, 2, 2, 3]


def test_a_file_keeps_places_to_half_a_cell():
    rng = np.random.default_rng(0)
    place = rng.uniform(-0.05, 0.05, (300, 3)) * [1.0, 1.0, 0.0]
    depth = np.r_[np.zeros(100), rng.uniform(0.001, 0.02, 200)]
    kept = FittedContacts.of(Contacts(place, depth))
    assert kept is not None and kept.cell == CELL
    read = FittedContacts.from_text(kept.text)
    assert read.deepest == depth.max()
    assert read.distance(place[100:]).max() <= CELL / math.sqrt(2.0)
    assert read.distance(np.array([[0.0, 0.0, 0.3]]))[0] == pytest.approx(0.3, abs=1e-3)
    assert read.distance(place[:100]).max() > 2.0 * CELL  # these were in the air


def test_many_places_are_kept_in_larger_cells():
    place = np.random.default_rng(1).uniform(0.0, 0.4, (20_000, 3)) * [1.0, 1.0, 0.0]
    kept = FittedContacts.of(Contacts(place, np.ones(len(place))))
    assert kept is not None and len(kept.cells) <= MOST_CELLS
    assert kept.cell == 4.0 * CELL and len(kept.text) < 20_000
    assert kept.distance(place).max() <= kept.cell / math.sqrt(2.0) + 1e-12


def test_nothing_is_kept_of_a_probe_in_the_air():
    assert FittedContacts.of(Contacts(np.zeros((5, 3)), np.zeros(5))) is None


@pytest.mark.parametrize(
    "facts",
    [
        [1, 2],
        {"cell_m": 0.004, "deepest_m": 0.01},
        {"cell_m": 0.004, "deepest_m": 0.01, "cells": []},
        {"cell_m": 0.004, "deepest_m": 0.01, "cells": [[1, 2]]},
        {"cell_m": 0.004, "deepest_m": 0.01, "cells": [[1, 2, math.nan]]},
        {"cell_m": -0.004, "deepest_m": 0.01, "cells": [[1, 2, 3]]},
        {"cell_m": 0.004, "deepest_m": "deep", "cells": [[1, 2, 3]]},
    ],
)
def test_damaged_contacts_are_refused(facts):
    with pytest.raises(FileError, match="fit the field again"):
        FittedContacts.from_text(json.dumps(facts))


def test_every_frame_in_contact_is_in_one_bin_of_each_kind():
    """Fitted at one place, 10 mm deep; errors of 1, 2, … N at chosen distances."""
    away = np.array([0.0, 0.019, 0.021, 0.06, 0.3, 0.5])
    depth = np.array([0.004, 0.006, 0.01, 0.012, 0.004, 0.0])  # the last in the air
    fitted = FittedContacts(CELL, np.zeros((1, 3)), 0.01)
    place = np.c_[away, np.zeros((6, 2))]
    recorded = presses(np.zeros(6), depth)
    wrench = np.zeros((6, 6))
    wrench[:, 0] = np.arange(1.0, 7.0)
    judged = compare(recorded, as_rendered(wrench))
    far, deep = by_distance_and_depth(fitted, Contacts(place, depth), judged)

    def told(found):
        sizes = [b.errors and b.errors.force_magnitude_error_N for b in found]
        return [b.frames for b in found], sizes

    assert told(far) == ([2, 1, 1, 1], [1.5, 3.0, 4.0, 5.0])
    # as deep as the deepest is not deeper
    assert told(deep) == ([2, 2, 1], [3.0, 2.5, 4.0])
    assert [b.as_dict()["to"] for b in far] == [0.02, 0.05, 0.1, None]
    (empty,) = bins(np.full(6, np.nan), (0.0, 1.0), judged)
    assert empty.as_dict() == {"from": 0.0, "to": 1.0, "frames": 0, "errors": None}


def test_tilted_probes_touch_as_in_the_rows_and_as_for_comparators():
    scene = small_scene("trilinear", n_poses=20)
    poses, surface = scene.trajectory, scene.voxmap.surface
    tilted = replace(poses, rotation=Rotation.random(20, random_state=2).as_matrix())
    geometry = ContactGeometry(surface, scene.shell)
    touches = map(geometry.touch, tilted.rotation, tilted.position)
    patches = [touch.patch for touch in touches]
    found = Contacts.of(surface, scene.shell, tilted)
    np.testing.assert_allclose(found.depth, [p.depth for p in patches], atol=1e-3)
    on = found.depth > 2e-3
    centre = np.array([p.centre for p in patches])[on]
    centre[:, :2] *= (
        np.linalg.norm(found.place[on, :2], axis=1)
        / np.linalg.norm(centre[:, :2], axis=1)
    )[:, None]
    assert on.sum() > 10
    np.testing.assert_allclose(found.place[on], centre, atol=1e-3)
    upright = Contacts.of(surface, scene.shell, poses).depth
    np.testing.assert_array_equal(upright > 0.0, scene.rows.contact_points > 0)
