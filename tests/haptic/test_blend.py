"""Swapping fields under a moving probe: force rate, energy, and the observed ΔU."""

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from tests.kit import InputError, ellipsoid, refuses, some, torso
from ttus_opt.haptic import blend
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.probe.cylindrical import cylindrical
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap

SURFACE = torso()
VOXMAP = Voxmap.from_surface(SURFACE, shape=(30, 90, 31), r_inner=0.03)
AXES = (0.02, 0.015, 0.012)
GRID = VOXMAP.grid
SAMPLINGS, RESERVES = ("trilinear", "voxel-mean"), (0.0, 2e-5)
QUICK = {("trilinear", 0.0, 0), ("trilinear", 2e-5, 1), ("voxel-mean", 2e-5, 2)}
THETA, Z = np.meshgrid(GRID.theta, GRID.z, indexing="ij")
DEPTH = SURFACE.radius_at(THETA, Z)[None] - GRID.r[:, None, None]  # [m]


def shell(n_points=600):
    return ellipsoid(n_points, AXES)


def field_of(stiffness, sampling="trilinear"):
    """Pressure in proportion to depth [N/cm² per cm], bumpy so that fields differ."""
    bumps = 1.0 + 0.3 * np.sin(3 * THETA) * np.cos(40 * Z)
    return PotentialField(VOXMAP, stiffness * 100 * DEPTH * bumps, sampling)


def stored_energy(field, R, at):
    """∫ p dV over the part of the probe inside the patient [J], by random points."""
    cube = np.random.default_rng(0).uniform(-1, 1, (200_000, 3))
    points = cube[(cube**2).sum(axis=1) < 1] * AXES
    closed = np.concatenate([field.values, field.values[:, :1]], axis=1)
    interpolate = RegularGridInterpolator(
        (GRID.r, np.append(GRID.theta, 2 * np.pi), GRID.z), closed, bounds_error=False
    )
    r, theta, z = cylindrical(points @ R.T + at)
    inside = r < SURFACE.radius_at(theta, z)
    p = interpolate(np.stack([r, theta, z], axis=1)[inside])
    volume = 4 / 3 * np.pi * np.prod(AXES)
    return float(p.sum() / len(points) * volume / 1e-4)


@dataclass
class Walk:
    """A smooth random motion that starts and ends in the air, in contact between."""

    rotation: np.ndarray
    position: np.ndarray

    @classmethod
    def make(cls, seed, n=1200):
        rng = np.random.default_rng(seed)
        t = np.linspace(0, 1, n)
        tones = np.arange(1, 6)

        def wander(size):
            phase, part = rng.uniform(0, 2 * np.pi, 5), rng.normal(size=5) / tones
            return size * (
                part @ np.sin(2 * np.pi * np.outer(tones, t) + phase[:, None])
            )

        depth = 0.006 * np.abs(np.sin(4 * np.pi * t)) + wander(0.001)
        # in from the air and out again, smoothly: work is summed frame by frame
        share = np.clip(np.minimum(t, 1 - t) / 0.15, 0, 1)
        depth = (3 * share**2 - 2 * share**3) * (depth + 0.005) - 0.005
        angle, z = 1.4 + wander(0.1), 0.1 + wander(0.01)
        r = SURFACE.radius_at(angle, z) + 0.012 - depth
        position = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
        turns = np.stack([wander(0.15), wander(0.15), wander(0.15)], axis=1)
        return cls(Rotation.from_rotvec(turns).as_matrix(), position)


def wrench(renderer, R, at):
    out = np.zeros(6)
    renderer.render_into(R, at, out)
    return out


def twist(walk):
    """Motion to each frame from the one before: reference point and turn, (n, 6)."""
    centres = walk.position + walk.rotation @ shell().reference
    before = np.roll(walk.rotation, 1, axis=0)
    turn = Rotation.from_matrix(walk.rotation @ np.swapaxes(before, 1, 2))
    moved = centres - np.roll(centres, 1, axis=0)
    return np.concatenate([moved, turn.as_rotvec()], axis=1)


def test_motion_is_displacement_and_rotation_vector_since_the_pose_kept():
    walk, ledger = Walk.make(3, n=50), blend.settled_ledger(0.0)
    reference, R, at = np.array([0.003, -0.002, 0.001]), np.empty((3, 3)), np.empty(3)
    for k in range(50):
        found = blend.follow(ledger, walk.rotation[k], walk.position[k], reference)
        blend.pose_of(ledger, reference, R, at)
        np.testing.assert_array_equal(R, walk.rotation[k])
        np.testing.assert_allclose(at, walk.position[k], atol=1e-15)
        if k:
            centres = walk.position + walk.rotation @ reference
            turn = Rotation.from_matrix(walk.rotation[k] @ walk.rotation[k - 1].T)
            np.testing.assert_allclose(found[:3], centres[k] - centres[k - 1])
            np.testing.assert_allclose(found[3:], turn.as_rotvec(), atol=1e-15)
        else:
            assert found == (0.0,) * 6


def test_stored_energy_is_found_on_the_way_away_from_the_axis():
    """Each field's force along it, rendered by itself, by the trapezoidal rule."""
    R = Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix()
    r = SURFACE.radius_at(np.array([0.5]), np.array([0.1])).item() + 0.008
    at, probe = np.array([r * np.cos(0.5), r * np.sin(0.5), 0.1]), shell()
    ledger, pair = blend.settled_ledger(0.0), (field_of(1.0), field_of(1.6))
    blend.follow(ledger, R, at, probe.reference)
    data = FrameData.of(VOXMAP, probe, "trilinear")
    opened = blend.opened_ledger(ledger, *(f.values.reshape(-1) for f in pair), data)
    way = (at + R @ probe.reference) * [1.0, 1.0, 0.0]
    way /= np.linalg.norm(way)
    places = [at + n * blend.RETREAT_STEP * way for n in range(30)]
    both = [Renderer(field, probe) for field in pair]
    old, new = ([wrench(one, R, place)[:3] for place in places] for one in both)
    along = (np.array(new) - np.array(old)) @ way
    assert along[0] > 0.1 and along[-1] == 0.0
    assert opened[blend.GAP] == pytest.approx(
        np.trapezoid(along, dx=blend.RETREAT_STEP), rel=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize("new", [1.6, 0.3])
def test_stored_energy_at_the_start_is_the_volume_integral(new):
    """The way out finds ∫ (p_new − p_old) dV over the sunk part of the probe."""
    R = Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix()
    at = np.array([0.01, 0.093, 0.1])
    renderer = Renderer(field_of(1.0), shell(4000))
    renderer.render(R, at)
    renderer.update(field_of(new))
    expected = stored_energy(field_of(new - 1.0), R, at)
    assert renderer.blend.stored_gap == pytest.approx(expected, rel=0.04)


#: Sampling, reserve and seed: all of them, three that are quick to have
WALKS = [
    pytest.param(*case, marks=[] if case in QUICK else [pytest.mark.slow])
    for case in itertools.product(SAMPLINGS, RESERVES, range(3))
]


@pytest.mark.slow
@pytest.mark.parametrize(("sampling", "reserve", "seed"), WALKS)
def test_no_jump_and_no_energy_over_random_motions_and_updates(sampling, reserve, seed):
    """Every frame: field-made change of force within the rate; Σ δa ΔU within."""
    rng = np.random.default_rng(seed)
    law = blend.BlendLaw(force_rate=20.0, reserve=reserve)
    walk = Walk.make(seed)
    renderer = Renderer(field_of(1.0, sampling), shell(), blend=law)
    mix = target = field_of(1.0, sampling)
    share, moved = 1.0, 0
    for k, (R, at) in enumerate(zip(walk.rotation, walk.position, strict=True)):
        if k % 75 == 74:
            blended = (1 - share) * mix.values + share * target.values
            mix = PotentialField(VOXMAP, blended, sampling)
            target = field_of(rng.uniform(0.3, 2.0), sampling)
            renderer.update(target)
            old, new = Renderer(mix, shell()), Renderer(target, shell())
            assert renderer.blend.progress == 0.0
            share = 0.0
        found = wrench(renderer, R, at)
        state = renderer.blend
        assert state.injected <= reserve + 1e-15
        assert state.tank >= 0.0
        assert state.progress >= share
        if k >= 75:
            a, b = wrench(old, R, at), wrench(new, R, at)
            expected = (1 - state.progress) * a + state.progress * b
            np.testing.assert_allclose(found, expected, atol=1e-12)
            jump = (state.progress - share) * (b - a)
            limit = law.force_rate * law.frame_seconds * (1 + 1e-9)
            assert np.linalg.norm(jump[:3]) <= limit
            assert np.linalg.norm(jump[3:]) <= limit * shell().rms_radius
            moved += state.progress > share
        share = state.progress
    assert moved > 10  # swaps did happen


def work_of_a_walk(seed, *, passive):
    """Work done on the probe, and the largest energy it had given, both [J].

    A field stands still while the probe moves and changes while it stands. Work is
    taken with wrenches of renderers that never change, not with the blend's ledger.
    """
    rng = np.random.default_rng(seed + 100)
    walk = Walk.make(seed)
    moved = twist(walk)
    renderer = Renderer(
        field_of(1.0), shell(4000), blend=blend.BlendLaw(force_rate=1e3)
    )
    base = Renderer(field_of(1.0), shell(4000))  # every field is a multiple of this one
    mix = target = 1.0
    share, work, least = 1.0, 0.0, 0.0
    last = wrench(base, walk.rotation[0], walk.position[0])
    renderer.render(walk.rotation[0], walk.position[0])
    for k in range(1, len(walk.position)):
        R, at = walk.rotation[k], walk.position[k]
        before = (1 - share) * mix + share * target
        here = wrench(base, R, at)
        gain = before * 0.5 * (last + here) @ moved[k]
        work, last = work + gain, here
        least = min(least, work)
        if k % 20 == 0:
            mix, share = before, 0.0
            # the worst that updates can do: stiff on the way out, soft on the way in
            target = rng.uniform(1.4, 2.0) if gain > 0 else rng.uniform(0.3, 0.6)
            renderer.update(field_of(target))
            if not passive:
                share = 1.0
        renderer.render(R, at)
        if passive:
            share = renderer.blend.progress
    return work, -least


@pytest.mark.slow
@pytest.mark.parametrize("seed", some(range(4), 2))
def test_a_round_trip_gives_no_energy(seed):
    """From air to air, the probe gets no work out of updates; carelessly it does."""
    work, given = work_of_a_walk(seed, passive=True)
    assert given > 1e-3
    assert work < 0.002 * given  # what the shell's quadrature leaves a still field
    careless, given = work_of_a_walk(seed, passive=False)
    assert careless > 0.5 * given


def test_softer_comes_at_the_force_rate_and_stiffer_waits_for_the_air():
    R, at = np.eye(3), np.array([0.0, 0.093, 0.1])
    away = np.array([0.0, 0.193, 0.1])
    renderer = Renderer(field_of(1.0), shell(), blend=blend.BlendLaw(force_rate=2.0))
    full = np.linalg.norm(renderer.render(R, at).force)
    renderer.update(field_of(0.5))
    frames = 0
    while renderer.blend.progress < 1.0:
        renderer.render(R, at)
        frames += 1
    assert frames == np.ceil(0.5 * full / 2e-3)
    renderer.update(field_of(1.9))  # takes 0.9/0.5 more than the tank was given
    for _ in range(5000):
        force = renderer.render(R, at).force
    state = renderer.blend
    assert state.tank == pytest.approx(0.0, abs=1e-15)
    assert np.linalg.norm(force) == pytest.approx(full, rel=1e-6)  # no more than before
    assert state.progress < 1.0
    renderer.render(R, away)
    assert renderer.blend.progress == 1.0
    expected = Renderer(field_of(1.9), shell()).render(R, at).force
    np.testing.assert_array_equal(renderer.render(R, at).force, expected)


def test_an_update_amid_a_swap_does_not_show_in_the_force():
    R, at = np.eye(3), np.array([0.0, 0.093, 0.1])
    law = blend.BlendLaw(force_rate=1.0, reserve=1.0)
    renderer = Renderer(field_of(1.0), shell(), blend=law)
    before = renderer.render(R, at).force
    for stiffness in (1.5, 0.2, 3.0, 1.0):
        renderer.update(field_of(stiffness))
        for _ in range(7):
            after = renderer.render(R, at).force
            assert np.linalg.norm(after - before) <= 1e-3 * (1 + 1e-9)
            before = after


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"force_rate": 0.0}, "force_rate must be positive"),
        ({"frame_seconds": float("nan")}, "frame_seconds must be positive"),
        ({"reserve": -1.0}, "reserve must not be negative"),
        ({"capacity": float("inf")}, "capacity must not be negative"),
    ],
)
def test_unusable_laws(options, word):
    refuses(InputError, word, blend.BlendLaw, **options)
