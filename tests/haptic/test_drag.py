"""Drag of one pose and twist: against plain numpy, and what it may never do."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.drags import (
    LAWS,
    SHELL,
    SURFACE,
    VOXMAP,
    drag_by_hand,
    drag_by_points,
    normal_forces,
    pushing,
    unlimited,
)
from tests.kit import InputError, refuses
from ttus_opt.haptic.drag import DragLaw
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.voxmap.field import PotentialField


def random_pose(rng, highest=0.02):
    """Any rotation, the reference from ``highest`` above the skin to 2 cm below."""
    R = Rotation.random(rng=rng).as_matrix()
    angle, z = rng.uniform(0, 2 * np.pi), rng.uniform(0.01, 0.19)
    r = SURFACE.radius_at(np.array(angle), np.array(z)) + rng.uniform(-0.02, highest)
    centre = np.array([r * np.cos(angle), r * np.sin(angle), z])
    speed = 10.0 ** rng.uniform(-5, 0)
    twist = rng.normal(size=6) * speed * np.array([1, 1, 1, 30, 30, 30])
    return R, centre - R @ SHELL.reference, twist


@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
@pytest.mark.parametrize("law", LAWS)
def test_drag_is_that_of_the_points_depths(law, sampling):
    rng = np.random.default_rng(4)
    field = pushing(sampling, LAWS[law])
    renderer, bare = unlimited(field), unlimited(pushing(sampling, {}))
    dragged = 0
    for _ in range(60):
        R, at, twist = random_pose(rng)
        contact, whole = bare.render(R, at), renderer.render(R, at, twist)
        drag = drag_by_hand(field, SHELL, R, at, twist, contact.force)
        np.testing.assert_allclose(
            whole.force, contact.force + drag[:3], rtol=1e-9, atol=1e-11
        )
        np.testing.assert_allclose(
            whole.torque, contact.torque + drag[3:], rtol=1e-9, atol=1e-12
        )
        dragged += bool(drag.any())
    assert (dragged > 30) == (law != "none")


@pytest.mark.slow
@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_friction_only_takes_energy(seed):
    """Its power is never above 0: any pose, any twist, fields that pull too."""
    rng = np.random.default_rng(seed)
    R, at, twist = random_pose(rng)
    law = LAWS[list(LAWS)[rng.integers(len(LAWS))]]
    values = rng.normal(size=VOXMAP.grid.shape)
    sampling = ("voxel-mean", "trilinear")[rng.integers(2)]
    whole = unlimited(PotentialField(VOXMAP, values, sampling, law))
    bare = unlimited(PotentialField(VOXMAP, values, sampling))
    a, b = whole.render(R, at, twist), bare.render(R, at, twist)
    at_reference = twist[:3] + np.cross(twist[3:], R @ SHELL.reference)
    force, torque = a.force - b.force, a.torque - b.torque
    power = force @ at_reference + torque @ twist[3:]
    scale = np.linalg.norm(force) * np.linalg.norm(at_reference)
    scale += np.linalg.norm(torque) * np.linalg.norm(twist[3:])
    assert power <= 1e-12 * scale


@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
def test_a_point_that_pulls_does_not_drag(sampling):
    """Where points pull and others press: of these alone."""
    rng, pulled = np.random.default_rng(8), 0
    field = pushing(sampling, LAWS["coulomb-points"])
    bumps = np.sign(np.sin(7.0 * VOXMAP.grid.theta))[:, None]
    field = replace(field, values=field.values * bumps)
    renderer = Renderer(field, SHELL)
    bare = Renderer(replace(field, parameters={}), SHELL)
    for _ in range(20):
        R, at, twist = random_pose(rng)
        whole, contact = renderer.render(R, at, twist), bare.render(R, at)
        drag = drag_by_points(field, SHELL, R, at, twist)
        np.testing.assert_allclose(whole.force, contact.force + drag[:3], atol=1e-11)
        np.testing.assert_allclose(whole.torque, contact.torque + drag[3:], atol=1e-12)
        pressed = normal_forces(field, SHELL, SHELL.points @ R.T + at)
        pulled += bool((pressed < 0.0).any() and (pressed > 0.0).any())
    assert pulled > 8


def test_a_straight_press_is_resisted_by_the_flanks():
    """The patch slides nowhere; its points do, so that a press takes energy."""
    angle, z = np.array(1.2), np.array(0.1)
    r = float(SURFACE.radius_at(angle, z))
    out = np.array([np.cos(1.2), np.sin(1.2), 0.0])
    at = (r + 0.003) * out + [0.0, 0.0, 0.1] - SHELL.reference
    speed = 0.02 * np.concatenate([out, np.zeros(3)])
    renderer = Renderer(pushing("trilinear", LAWS["coulomb-points"]), SHELL)
    into, rest, out_of = (
        float(renderer.render(np.eye(3), at, s * speed).force @ out) for s in (-1, 0, 1)
    )
    assert rest > 1.0
    assert into - rest == pytest.approx(rest - out_of)
    assert 0.02 * rest < into - rest < 0.3 * rest


@pytest.mark.parametrize("law", ["coulomb", "coulomb-points"])
def test_no_motion_or_no_contact_no_drag(law):
    renderer = Renderer(pushing("trilinear", LAWS[law]), SHELL)
    bare = Renderer(pushing("trilinear", {}), SHELL)
    R, at, twist = random_pose(np.random.default_rng(1), highest=0.0)
    still = renderer.render(R, at, np.zeros(6))
    assert still.contact_points > 0
    assert still.drag == "given"
    np.testing.assert_array_equal(still.force, bare.render(R, at).force)
    away = at + np.array([0.3, 0.3, 0.0])
    assert not renderer.render(R, away, twist).force.any()


@pytest.mark.parametrize(
    ("parameters", "word"),
    [
        ({"friction_coefficient": -0.1}, "friction_coefficient of a field must not"),
        ({"friction_coefficient": float("nan")}, "must not be negative, got nan"),
        ({"viscous_coefficient": -1.0}, "viscous_coefficient of a field must not"),
        (
            {"viscous_coefficient": 1.0, "viscous_coefficient_0": -1.0},
            "viscous_coefficient_0",
        ),
        (
            {"friction_coefficient": 0.1, "drag_deadband": 0.0},
            "drag_deadband must be positive",
        ),
        (
            {"friction_coefficient": 0.1, "drag_at_reference": 1.0},
            "give drag_axis_x, drag_axis_y, drag_axis_z",
        ),
        ({**LAWS["coulomb-reference"], "drag_axis_x": 0.9}, "unit length"),
        ({"viscous_sectors": 0.0}, "at least one sector"),
        ({**LAWS["coulomb-reference"], "drag_at_points": 1.0}, "cannot have both"),
        ({"drag_at_points": 0.5}, "drag_at_points of a field must be 0 or 1, got 0.5"),
        ({"drag_at_reference": -1.0}, "drag_at_reference of a field must be 0 or 1"),
    ],
)
def test_what_is_no_drag(parameters, word):
    refuses(InputError, word, DragLaw.of, parameters, VOXMAP.grid)
    if any(map(math.isnan, parameters.values())):  # no field has such a parameter
        word = "must be a finite number, got nan"
    refuses(InputError, word, lambda: Renderer(pushing("trilinear", parameters), SHELL))


def test_a_neutral_coefficient_is_no_drag():
    """What the data could not bear is 0, and asks nobody for a motion."""
    neutral = {"friction_coefficient": 0.0, "viscous_coefficient": 0.0}
    assert not DragLaw.of(neutral, VOXMAP.grid).active
    renderer = Renderer(pushing("trilinear", neutral), SHELL)
    R, at, _ = random_pose(np.random.default_rng(1), highest=0.0)
    assert renderer.render(R, at).drag == "none"
