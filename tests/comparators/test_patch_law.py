"""What every law with parameters per patch does, and what each finds of its data."""

import math

import numpy as np
import pytest

from tests.comparators.contacts import (
    NO_PATCH,
    STILL,
    after_one_sample,
    contacts,
    made,
    samples,
)
from tests.comparators.recordings import facing, fitted
from tests.kit import InputError, refuses, torso
from ttus_opt.comparators.patch_law import (
    AROUND,
    HEIGHT,
    HuntCrossleyLog,
    HuntCrossleyTwoStage,
    KelvinVoigt,
    PatchGrid,
    RecursiveLeastSquares,
)
from ttus_opt.comparators.patch_model import Contact


@pytest.mark.parametrize("kind", [KelvinVoigt, HuntCrossleyLog, HuntCrossleyTwoStage])
def test_a_probe_that_leaves_fast_is_not_pulled(kind):
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


@pytest.mark.parametrize("name", ["kelvin_voigt", "hunt_crossley_log"])
def test_a_faster_approach_pushes_no_less(name):
    law = fitted(name)
    place = np.array([0.03, 0.09, 0.1])
    forces = [
        law._normal_force(Contact(0.6, rate, place, STILL, NO_PATCH))
        for rate in (-1.0, 0.0, 1.0)
    ]
    assert forces == sorted(forces)


def test_forgetting_that_makes_no_sense_is_told():
    refuses(InputError, "forgetting must be in", made, KelvinVoigt, forgetting=0.0)


def test_kelvin_voigt_finds_spring_and_damper():
    rng = np.random.default_rng(2)
    found = contacts(200, rng)
    forces = np.array([7.0 * c.depth + 0.3 * c.rate for c in found])
    law = made(KelvinVoigt, forgetting=1.0)
    law._fit_law(samples(found, forces))
    np.testing.assert_allclose(
        law.per_patch, [[7.0, 0.3]] * len(law.per_patch), rtol=0.01
    )


def test_the_first_sample_of_kelvin_voigt_is_weighed_against_what_is_known_of_tissue():
    """5 ± 50 N at 10 mm and no damping, 0 ± 5 N s, beside 9 ± 1 N of one sample."""
    found = after_one_sample(KelvinVoigt, 0.8, 0.5, 9.0)
    rows = np.vstack([np.diag([1 / 50, 1 / 5]), [0.8, 0.5]])
    expected, *_ = np.linalg.lstsq(rows, np.array([5.0 / 50, 0.0, 9.0]))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_the_logarithm_finds_the_same_where_damping_is_small():
    rng = np.random.default_rng(4)
    found = contacts(800, rng, rate=0.2)
    forces = np.array([6.0 * c.depth**1.7 * (1.0 + 0.1 * c.rate) for c in found])
    law = made(HuntCrossleyLog)
    law._fit_law(samples(found, forces))
    expected = [math.log(6.0), 1.7, 0.1]
    np.testing.assert_allclose(law.per_patch.mean(axis=0), expected, rtol=0.02)
    fast = Contact(0.8, 3.0, found[0].place, STILL, NO_PATCH)
    assert law._normal_force(fast) == pytest.approx(6.0 * 0.8**1.7 * 1.3, rel=0.03)


def test_a_fast_retreat_by_the_logarithm_does_not_pull():
    law = HuntCrossleyLog._law
    back = Contact(0.8, -30.0, np.zeros(3), STILL, NO_PATCH)
    assert law(made(HuntCrossleyLog), np.array([math.log(6.0), 1.7, 0.1]), back) == 0.0


def test_two_stages_find_stiffness_damping_and_exponent():
    rng = np.random.default_rng(3)
    found = contacts(800, rng, rate=0.5)
    forces = np.array([c.depth**1.3 * (6.0 + 0.8 * c.rate) for c in found])
    law = made(HuntCrossleyTwoStage)
    law._fit_law(samples(found, forces))
    np.testing.assert_allclose(law.per_patch.mean(axis=0), [6.0, 0.8, 1.3], rtol=0.03)


def test_the_first_sample_of_two_stages_is_weighed_against_what_is_known_of_tissue():
    """5 ± 50 N, damping 0 ± 5 N s and, with these, Hertz's exponent 1.5 ± 5."""
    h, v, f = 0.8, 0.5, 9.0
    found = after_one_sample(HuntCrossleyTwoStage, h, v, f)
    rows = np.vstack([np.diag([1 / 50, 1 / 5]), h**1.5 * np.array([1.0, v])])
    (K, B), *_ = np.linalg.lstsq(rows, np.array([5.0 / 50, 0.0, f]))
    x, y = np.array([1 / 5, np.log(h)]), np.array([1.5 / 5, np.log(f / (K + B * v))])
    np.testing.assert_allclose(found, [K, B, x @ y / (x @ x)], rtol=1e-12)


def test_shares_of_patches_add_up_and_are_continuous_round_the_seam():
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


def test_shares_interpolate_between_evenly_spread_patches():
    """Angle and height, which are linear, come back; beyond the ends, the end's."""
    surface, rng = torso(), np.random.default_rng(0)
    grid = PatchGrid(surface)
    heights = np.linspace(surface.z[0], surface.z[-1], grid.n_patches // AROUND)
    assert 0.75 * HEIGHT < heights[1] - heights[0] < 1.5 * HEIGHT
    for angle, z in zip(
        rng.uniform(0.0, 2.0 * np.pi, 40), rng.uniform(-0.05, 0.25, 40), strict=True
    ):
        found = grid.shares(np.array([0.1 * np.cos(angle), 0.1 * np.sin(angle), z]))
        patch, share = (np.array(each) for each in zip(*found, strict=True))
        around, along = np.divmod(patch, len(heights))
        assert share @ heights[along] == pytest.approx(np.clip(z, 0.0, 0.2))
        turns = np.exp(1j * (2.0 * np.pi * around / AROUND - angle))
        assert share @ np.angle(turns) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("weights", [np.ones(40), np.linspace(0.1, 1.0, 40)])
def test_the_recursion_is_least_squares_with_a_prior(weights):
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


def test_forgetting_weighs_old_samples_less():
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(60, 2)), rng.normal(size=60)
    recursion = RecursiveLeastSquares.start(np.zeros(2), np.full(2, 1e4), 0.9)
    for row, value in zip(x, y, strict=True):
        recursion.update(row, value)
    root = 0.9 ** (0.5 * np.arange(59, -1, -1))
    batch, *_ = np.linalg.lstsq(root[:, None] * x, root * y, rcond=None)
    np.testing.assert_allclose(recursion.estimate, batch, atol=1e-6)
