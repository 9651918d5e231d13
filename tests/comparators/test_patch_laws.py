"""Laws of depth and rate find the numbers their data were made with."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.comparators.recordings import facing, fitted, recordings
from tests.conftest import ellipsoid, torso
from ttus_opt.arrays import Array
from ttus_opt.comparators.base import Comparator
from ttus_opt.comparators.contact_geometry import Patch
from ttus_opt.comparators.hunt_crossley_log import HuntCrossleyLog
from ttus_opt.comparators.hunt_crossley_two_stage import HuntCrossleyTwoStage
from ttus_opt.comparators.kelvin_voigt import KelvinVoigt
from ttus_opt.comparators.patch_grid import AROUND, PatchGrid
from ttus_opt.comparators.patch_law import PatchLaw
from ttus_opt.comparators.patch_model import Contact, Sample
from ttus_opt.comparators.perceptual_updates import PerceptualUpdates
from ttus_opt.comparators.recursive_least_squares import RecursiveLeastSquares
from ttus_opt.errors import InputError

NO_PATCH = Patch(0.0, 0.0, np.zeros(6), np.zeros(3), np.zeros(3))
STILL = np.zeros(3)


def contacts(n: int, rng: np.random.Generator, rate: float = 1.0) -> list[Contact]:
    """Depths of 2 to 12 mm at the front, approached and left."""
    angles, heights = rng.uniform(0.5, 2.5, n), rng.uniform(0.05, 0.15, n)
    places = [
        [0.1 * math.cos(a), 0.1 * math.sin(a), z]
        for a, z in zip(angles, heights, strict=True)
    ]
    return [
        Contact(float(h), float(v), np.array(s), STILL, NO_PATCH)
        for h, v, s in zip(
            rng.uniform(0.2, 1.2, n), rate * rng.normal(size=n), places, strict=True
        )
    ]


def samples(found: list[Contact], forces: Array) -> list[Sample]:
    return [Sample(c, float(f), STILL) for c, f in zip(found, forces, strict=True)]


def made(kind: type[PatchLaw], **options: float) -> PatchLaw:
    return kind(surface=torso(), shell=ellipsoid(), **options)


@pytest.mark.parametrize("weights", [np.ones(40), np.linspace(0.1, 1.0, 40)])
def test_the_recursion_is_least_squares_with_a_prior(weights: Array) -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(40, 3)), rng.normal(size=40)
    first, spread = np.array([1.0, -1.0, 0.5]), np.array([2.0, 0.5, 1.0])
    recursion = RecursiveLeastSquares.start(first, spread, 1.0)
    for row, value, weight in zip(x, y, weights, strict=True):
        recursion.update(row, value, weight)
    root = np.sqrt(weights)
    stacked = np.vstack([np.diag(1.0 / spread), root[:, None] * x])
    target = np.concatenate([first / spread, root * y])
    batch, *_ = np.linalg.lstsq(stacked, target, rcond=None)
    np.testing.assert_allclose(recursion.estimate, batch, atol=1e-12)
    assert recursion.samples == pytest.approx(weights.sum())


def test_forgetting_weighs_old_samples_less() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(60, 2)), rng.normal(size=60)
    recursion = RecursiveLeastSquares.start(np.zeros(2), np.full(2, 1e4), 0.9)
    for row, value in zip(x, y, strict=True):
        recursion.update(row, value)
    root = 0.9 ** (0.5 * np.arange(59, -1, -1))
    batch, *_ = np.linalg.lstsq(root[:, None] * x, root * y, rcond=None)
    np.testing.assert_allclose(recursion.estimate, batch, atol=1e-6)


def test_shares_of_patches_add_up_and_are_continuous_round_the_seam() -> None:
    grid = PatchGrid(torso())
    for place in ([0.1, -1e-12, 0.07], [0.1, 1e-12, 0.07], [-0.1, 0.0, 9.0]):
        shares = grid.shares(np.array(place))
        assert sum(share for _, share in shares) == pytest.approx(1.0)
        assert all(0 <= patch < grid.n_patches for patch, _ in shares)
    before, after = (
        {p for p, w in grid.shares(np.array([0.1, y, 0.07])) if w > 1e-6}
        for y in (-1e-12, 1e-12)
    )
    assert before == after
    assert grid.n_patches % AROUND == 0


def test_kelvin_voigt_finds_spring_and_damper() -> None:
    rng = np.random.default_rng(2)
    found = contacts(200, rng)
    forces = np.array([7.0 * c.depth + 0.3 * c.rate for c in found])
    law = made(KelvinVoigt, forgetting=1.0)
    law._fit_law(samples(found, forces))
    np.testing.assert_allclose(
        law.per_patch, [[7.0, 0.3]] * len(law.per_patch), rtol=0.01
    )


def test_two_stages_find_stiffness_damping_and_exponent() -> None:
    rng = np.random.default_rng(3)
    found = contacts(800, rng, rate=0.5)
    forces = np.array([c.depth**1.3 * (6.0 + 0.8 * c.rate) for c in found])
    law = made(HuntCrossleyTwoStage)
    law._fit_law(samples(found, forces))
    np.testing.assert_allclose(law.per_patch.mean(axis=0), [6.0, 0.8, 1.3], rtol=0.03)


def test_the_logarithm_finds_the_same_where_damping_is_small() -> None:
    rng = np.random.default_rng(4)
    found = contacts(800, rng, rate=0.2)
    forces = np.array([6.0 * c.depth**1.7 * (1.0 + 0.1 * c.rate) for c in found])
    law = made(HuntCrossleyLog)
    law._fit_law(samples(found, forces))
    expected = [math.log(6.0), 1.7, 0.1]
    np.testing.assert_allclose(law.per_patch.mean(axis=0), expected, rtol=0.02)
    fast = Contact(0.8, 3.0, found[0].place, STILL, NO_PATCH)
    assert law._normal_force(fast) == pytest.approx(6.0 * 0.8**1.7 * 1.3, rel=0.03)


def test_each_patch_learns_its_own_stiffness() -> None:
    rng = np.random.default_rng(5)
    found = contacts(1500, rng, rate=0.0)
    stiff = np.array([4.0 if c.place[0] > 0.0 else 8.0 for c in found])
    law = made(KelvinVoigt, forgetting=1.0)
    law._fit_law(samples(found, stiff * [c.depth for c in found]))
    for angle, expected in ((0.7, 4.0), (2.3, 8.0)):
        place = np.array([0.1 * math.cos(angle), 0.1 * math.sin(angle), 0.1])
        force = law._normal_force(Contact(1.0, 0.0, place, STILL, NO_PATCH))
        # the prior, the mean over all patches, is worth ten of its samples
        assert force == pytest.approx(expected, rel=0.08)


def test_friction_and_stiffness_of_the_recordings_are_sent() -> None:
    law = fitted("perceptual_updates")
    assert isinstance(law, PerceptualUpdates)
    sent = law.parameters()
    assert 0.0 < sent["share"] < 0.6
    slide = recordings()[1]
    place = law.samples(slide, slide.force)[10].contact.place
    # 900 · 10 · (5 mm)^1.5 N at 5 mm, and the drag they were made with
    stiffness, friction = law.model_at(place)
    assert stiffness == pytest.approx(9000.0 * 0.005**1.5 / 0.5, rel=0.25)
    assert friction == pytest.approx(0.2, abs=0.05)


def test_a_finer_difference_sends_more() -> None:
    counts = []
    for jnd in (0.0, 0.1, 0.5):
        law = PerceptualUpdates(surface=torso(), shell=ellipsoid(), stiffness_jnd=jnd)
        law.fit(recordings())
        counts.append(len(law.updates))
    assert counts[0] > counts[1] > counts[2] >= 1
    assert counts[0] <= law.samples_seen


def test_an_update_is_sent_exactly_when_the_difference_is_noticeable() -> None:
    law = PerceptualUpdates(surface=torso(), shell=ellipsoid())
    place, still = np.array([0.1, 0.0, 0.1]), RecursiveLeastSquares.start
    for stiffness, friction, sent in (
        (5.0, 0.0, 1),
        (5.49, 0.04, 1),
        (5.51, 0.0, 2),
    ):
        law._send(
            place,
            still(np.array([stiffness]), np.ones(1), 1.0),
            still(np.array([friction]), np.ones(1), 1.0),
        )
        assert len(law.updates) == sent


@pytest.mark.parametrize("kind", [KelvinVoigt, HuntCrossleyLog, HuntCrossleyTwoStage])
def test_a_probe_that_leaves_fast_is_not_pulled(kind: type[PatchLaw]) -> None:
    rng = np.random.default_rng(6)
    found = contacts(60, rng, rate=0.5)
    forces = np.array([6.0 * c.depth * (1.0 + 0.3 * c.rate) for c in found])
    law = made(kind)
    law._fit_law(samples(found, forces))
    law.fitted = True
    R, at = facing(torso(), 1.3, 0.1, 0.004)
    outward = np.array([at[0], at[1], 0.0]) / np.hypot(at[0], at[1])
    rest, slow, fast = (
        law.render(R, at, np.concatenate([v * outward, np.zeros(3)])).force @ outward
        for v in (0.0, 0.01, 1.0)
    )
    assert rest > slow > 0.0
    assert fast == 0.0


def test_rendered_drag_is_against_the_motion_and_in_proportion() -> None:
    law = fitted("perceptual_updates")
    assert isinstance(law, PerceptualUpdates)
    R, at = facing(torso(), 1.3, 0.1, 0.005)
    along = np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
    rest, there, back = (law.render(R, at, v) for v in (None, along, -along))
    drag = there.force - rest.force
    np.testing.assert_allclose(drag, -(back.force - rest.force), atol=1e-3)
    share = -drag[2] / np.linalg.norm(rest.force)
    assert share == pytest.approx(0.2, abs=0.05)
    # it acts at the contact, on the probe's surface
    turned = there.torque - rest.torque
    arm = law.geometry.touch(R, at).patch.arm
    assert np.linalg.norm(arm) == pytest.approx(0.0135, abs=0.001)
    np.testing.assert_allclose(turned, np.cross(arm, drag), atol=1e-9)


@pytest.mark.parametrize("name", ["kelvin_voigt", "hunt_crossley_log"])
def test_a_faster_approach_pushes_no_less(name: str) -> None:
    law: Comparator = fitted(name)
    assert isinstance(law, PatchLaw)
    place = np.array([0.03, 0.09, 0.1])
    forces = [
        law._normal_force(Contact(0.6, rate, place, STILL, NO_PATCH))
        for rate in (-1.0, 0.0, 1.0)
    ]
    assert forces == sorted(forces)


def test_options_that_make_no_sense_are_told() -> None:
    with pytest.raises(InputError, match="forgetting must be in"):
        made(KelvinVoigt, forgetting=0.0)
    with pytest.raises(InputError, match="stiffness_jnd"):
        PerceptualUpdates(surface=torso(), shell=ellipsoid(), stiffness_jnd=-0.1)
