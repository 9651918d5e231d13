"""Friction before sliding: it holds, it is Coulomb's on a slide, it gives no energy."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.drags import LAWS, SHELL, SURFACE, VOXMAP, pushing, unlimited
from tests.kit import InputError, refuses
from ttus_opt.contact.contact_size import patches_of
from ttus_opt.haptic.drag import PRESLIDING, VISCOUS
from ttus_opt.haptic.field_wrench import wrenches_along
from ttus_opt.haptic.presliding import ALONG, BRISTLE, FLANK, STRENGTH, bend
from ttus_opt.haptic.presliding import LENGTH as LENGTH_OF

LENGTH, STILL = 1e-3, np.zeros(6)
LAW = {**LAWS["coulomb"], "presliding_length": LENGTH}
AT_POINTS = {**LAWS["coulomb-points"], "presliding_length": LENGTH}
AT_REFERENCE = {**LAWS["coulomb-reference"], "presliding_length": LENGTH}


def held(law, scale=1.0):
    field = pushing("trilinear", law)
    return replace(field, values=scale * field.values)


def place(along, depth=0.004, angle=1.2):
    """Origin of an upright probe, ``along`` z from the middle, pressed in [m]."""
    z = 0.1 + along
    r = float(SURFACE.radius_at(np.array(angle), np.array(z))) + 0.012 - depth
    return np.array([r * np.cos(angle), r * np.sin(angle), z]) - SHELL.reference


def drag_at(renderer, bare, at):
    held, free = renderer.render(np.eye(3), at, STILL), bare.render(np.eye(3), at)
    return held.force - free.force


def test_a_hand_that_stops_still_feels_the_drag():
    renderer, bare = unlimited(held(LAW)), unlimited(held({}))
    coulomb = unlimited(held(LAWS["coulomb"]))
    for along in np.linspace(0.0, 0.01, 101):
        drag = drag_at(renderer, bare, place(along))
    at, sliding = place(0.01), np.array([0.0, 0.0, 1e-1, 0.0, 0.0, 0.0])
    slid = place(0.01) - place(0.0099)
    sliding[:3] = 0.1 * slid / np.linalg.norm(slid)
    whole = coulomb.render(np.eye(3), at, sliding).force
    expected = whole - bare.render(np.eye(3), at).force
    assert np.linalg.norm(drag) > 0.5
    np.testing.assert_allclose(drag, expected, atol=0.01 * np.linalg.norm(expected))
    for _ in range(50):  # where the drag of today is none
        np.testing.assert_allclose(drag_at(renderer, bare, at), drag, rtol=1e-12)
    assert not drag_at(coulomb, bare, at).any()


def test_drag_builds_up_over_the_length():
    renderer, bare = unlimited(held(LAW)), unlimited(held({}))
    sizes = [
        np.linalg.norm(drag_at(renderer, bare, place(along)))
        for along in LENGTH * np.array([0.0, 0.25, 0.5, 1.5])
    ]
    assert sizes[0] == 0.0
    renderer.render(np.eye(3), place(0.0, -0.03), STILL)  # the way down counts not
    assert not drag_at(renderer, bare, place(LENGTH)).any()
    assert sizes[1] / sizes[3] == pytest.approx(0.25, abs=0.02)
    assert sizes[2] / sizes[3] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("law", [LAW, AT_REFERENCE, AT_POINTS])
@pytest.mark.parametrize("seed", range(2))
def test_no_closed_path_gives_energy(law, seed):
    """Random loops that slide, turn, press and lift: work taken is never negative."""
    rng = np.random.default_rng(seed)
    renderer, bare = unlimited(held(law)), unlimited(held({}))
    phase = 2.0 * np.pi * np.linspace(0.0, 1.0, 200)
    wave = rng.normal(size=(3, 6)) / (1.0 + np.arange(3))[:, None]
    offset = rng.uniform(0.0, 2.0 * np.pi, (3, 6))
    size = LENGTH * 10.0 ** rng.uniform(-0.5, 1.0) * np.array([1, 1, 1, 40, 40, 40])
    taken, last, lowest = 0.0, None, 0.0
    for angle in np.concatenate([phase, phase]):
        shift = size * (
            wave * np.sin((1 + np.arange(3))[:, None] * angle + offset)
        ).sum(0)
        R = Rotation.from_rotvec(shift[3:]).as_matrix()
        at = place(0.0, 0.006) + SHELL.reference + shift[:3] - R @ SHELL.reference
        a, b = renderer.render(R, at, STILL), bare.render(R, at)
        reference = at + R @ SHELL.reference
        if law is AT_REFERENCE:  # the flanks' drag stays across the pressing axis
            axis = R @ np.array(
                [LAWS["coulomb-reference"][f"drag_axis_{c}"] for c in "xyz"]
            )
            assert abs((a.force - b.force) @ axis) < 1e-12
        if last is not None:
            turn = Rotation.from_matrix(R @ last[1].T).as_rotvec()
            taken -= (a.force - b.force) @ (reference - last[0])
            taken -= (a.torque - b.torque) @ turn
        last = reference, R
        lowest = min(lowest, taken)
    assert taken > 0.0
    assert lowest >= -1e-12


def test_a_straight_press_drags_along_its_flanks_as_every_point_does():
    """Once pressed by 2ℓ the drag is the points' own, and turns round with it."""
    renderer, bare = unlimited(held(AT_POINTS)), unlimited(held({}))
    sliding = unlimited(held(LAWS["coulomb-points"]))
    for depths in (np.linspace(0.0, 0.006, 121), np.linspace(0.006, 0.003, 61)):
        for depth in depths:
            at = place(0.0, depth)
            drag = drag_at(renderer, bare, at)
        pressure = bare.render(np.eye(3), at).force
        patch = patches_of(VOXMAP, SHELL, np.eye(3)[None], at[None]).normal[0]
        way = np.concatenate([patch * np.sign(depths[0] - depths[1]), np.zeros(3)])
        each = sliding.render(np.eye(3), at, 0.1 * way).force - pressure
        assert drag @ way[:3] < -0.05 * np.linalg.norm(pressure)
        assert drag @ patch == pytest.approx(each @ patch, rel=0.02)


def test_pressing_harder_while_held_gives_no_energy():
    """Bent lightly, pressed, let go: b shrinks so that the force stays."""
    renderer, bare = unlimited(held(LAW)), unlimited(held({}))
    path = [(0.0, 0.002), (0.5, 0.002), (0.5, 0.006), (0.0, 0.006), (0.0, 0.002)]
    taken, last = 0.0, None
    forces = []
    for (a, low), (b, high) in itertools.pairwise(path):
        for share in np.linspace(0.0, 1.0, 200):
            at = place(LENGTH * (a + share * (b - a)), low + share * (high - low))
            drag = drag_at(renderer, bare, at)
            if last is not None:
                taken -= drag @ (at - last)
            last = at
        forces.append(drag)
    assert taken >= 0.0
    assert abs(forces[1][2]) < 1.1 * abs(forces[0][2])


@pytest.mark.parametrize("law", [LAW, AT_POINTS])
def test_a_recording_feels_what_the_renderer_renders(law):
    rng, n = np.random.default_rng(3), 60
    along = np.cumsum(rng.normal(size=n)) * LENGTH
    position = np.stack(
        [place(a, 0.004 + 0.002 * np.sin(k / 9)) for k, a in enumerate(along)]
    )
    position[30:35] += 0.05  # lifted off
    motion = tt.Trajectory.from_arrays(
        position, np.tile(np.eye(3), (n, 1, 1)), times=0.05 * np.arange(n)
    )
    field, renderer = held(law), unlimited(held(law))
    along_all = wrenches_along(field, SHELL, motion)
    for k in range(n):
        one = renderer.render(np.eye(3), position[k], motion.twist()[k])
        np.testing.assert_allclose(one.force, along_all.force[k], atol=1e-10)
        np.testing.assert_allclose(one.torque, along_all.torque[k], atol=1e-10)
    twice = wrenches_along(field, SHELL, tt.Trajectory.concatenate([motion, motion]))
    np.testing.assert_allclose(twice.force[n:], along_all.force, atol=1e-12)


def test_poses_alone_are_enough():
    renderer, bare = unlimited(held(LAW)), unlimited(held({}))
    renderer.render(np.eye(3), place(0.0))
    moved = renderer.render(np.eye(3), place(2 * LENGTH))  # no warning
    assert moved.drag == "estimated"
    contact = bare.render(np.eye(3), place(2 * LENGTH)).force
    assert np.linalg.norm(moved.force - contact) > 0.5


@pytest.mark.parametrize("law", [LAW, AT_POINTS])
@pytest.mark.parametrize("begins", [True, False])
def test_friction_that_begins_or_ends_with_a_swap_does_not_jump(law, begins):
    """An update during the swap, of which less, or more, than half is felt."""
    given = tt.BlendLaw(force_rate=8.0, reserve=0.05, capacity=0.05)
    laws, before = ({}, law) if begins else (law, {}), None
    renderer = tt.Renderer(held(laws[0]), SHELL, blend=given, force_limit=math.inf)
    for k, along in enumerate(np.linspace(0.0, 0.02, 1001)):
        if k in (400, 450 if begins else 570):
            share = renderer.blend.progress
            renderer.update(held(laws[1], 1.5 + 1e-3 * k))
        force = renderer.render(np.eye(3), place(along), STILL).force
        assert before is None or np.linalg.norm(force - before) < 0.02
        before = force
    assert 0.1 < share < 0.9


def test_an_update_leaves_the_force_of_a_held_probe():
    """To a stiffer, rougher field and to one without presliding: within the rate."""
    rougher = {"friction_coefficient": 0.6}
    for old, new in (
        (LAW, held({**LAW, **rougher}, 2.0)),
        (LAW, held(LAWS["coulomb"])),
        (AT_POINTS, held({**AT_POINTS, **rougher}, 2.0)),
    ):
        renderer, bare = unlimited(held(old)), unlimited(held({}))
        for along in np.linspace(0.0, 0.003, 61):
            before = renderer.render(np.eye(3), place(along), STILL).force
        assert np.linalg.norm(drag_at(renderer, bare, place(0.003))) > 0.5
        renderer.update(new)
        for _ in range(400):
            force = renderer.render(np.eye(3), place(0.003), STILL).force
            assert np.linalg.norm(force - before) < 0.0051  # 5 N/s, 1 ms
            before = force


@pytest.mark.parametrize("seed", range(20))
def test_another_field_does_not_raise_the_stored_energy(seed):
    """M ℓ |b|²/2 and M_n ℓ_n b_n²/2, of a probe that does not move."""
    rng = np.random.default_rng(seed)
    numbers, bristle = np.zeros(VISCOUS), np.zeros(BRISTLE)
    patch = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    bristle[1], bristle[ALONG] = 0.6, -0.5
    bristle[[STRENGTH, FLANK]] = rng.uniform(0.5, 2.0, 2)
    bristle[LENGTH_OF] = LENGTH * rng.uniform(0.25, 4.0)

    def stored():
        strength, length = bristle[STRENGTH], bristle[LENGTH_OF]
        along = (bristle[FLANK] * bristle[ALONG]) ** 2 * length / strength
        return strength * length * bristle[1] ** 2, along

    before, force = stored(), bristle[FLANK] * bristle[ALONG]
    numbers[PRESLIDING] = LENGTH
    new = rng.uniform(0.5, 2.0, 2)
    bend(bristle, (0.0,) * 6, np.eye(3), patch, *new, numbers)
    assert all(np.array(stored()) <= np.array(before) * (1.0 + 1e-12))
    assert abs(bristle[FLANK] * bristle[ALONG]) <= abs(force) * (1.0 + 1e-12)


def test_a_negative_length_is_refused():
    law = {**LAW, "presliding_length": -1.0}
    refuses(InputError, "presliding_length of a field must not", unlimited, held(law))
