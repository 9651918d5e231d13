"""The plane a body lies on: found when there, not invented when not."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.kit import InputError, refuses, some
from ttus_opt.scan import supporting_plane
from ttus_opt.scan.supporting_plane import find_supporting_plane


def torso(rng, n=20_000, *, upper=False):
    """An elliptic cylinder on the plane y = 0, along z, open or its upper half."""
    theta = rng.uniform(0, np.pi if upper else 2 * np.pi, n)
    x, y = 0.17 * np.cos(theta), 0.12 + 0.12 * np.sin(theta)
    return np.stack([x, y, rng.uniform(-0.25, 0.25, n)], axis=1)


def bed(rng, n, noise=0.003):
    x = rng.uniform(0.1, 0.4, n) * rng.choice([-1, 1], n)
    return np.stack([x, noise * rng.standard_normal(n), rng.uniform(-0.3, 0.3, n)], 1)


@pytest.mark.slow
@settings(max_examples=10)
@example(seed=2067, n_bed=1500, upper=False)  # escaped the first 600 trial planes
@given(st.integers(0, 10_000), st.sampled_from([1500, 8000, 40_000]), st.booleans())
def test_bed_is_found_in_any_attitude(seed, n_bed, upper):
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    shift = rng.uniform(-2, 2, 3)
    body, flat = torso(rng, upper=upper), bed(rng, n_bed)
    body = body[body[:, 1] > 0.02]  # no camera sees where it lies
    plane = find_supporting_plane(np.concatenate([body, flat]) @ turn.T + shift)
    assert np.degrees(np.arccos(min(1.0, float(plane.normal @ turn[:, 1])))) < 1.0
    assert abs(plane.height(shift[None])[0]) < 0.005
    assert plane.above(body @ turn.T + shift)[body[:, 1] > 0.03].all()
    assert not plane.above(flat @ turn.T + shift)[np.abs(flat[:, 1]) < 0.008].any()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_no_bed_none_found(seed):
    rng = np.random.default_rng(seed)
    assert find_supporting_plane(torso(rng)) is None
    assert find_supporting_plane(torso(rng, upper=True)) is None


@pytest.mark.slow
@pytest.mark.parametrize("trials", some([150, 600], 1))
def test_cut_ends_are_not_a_bed(trials, monkeypatch):
    """The flat end of a closed torso has the body on one side, but no rim."""
    monkeypatch.setattr(supporting_plane, "_N_TRIALS", trials)
    rng = np.random.default_rng(0)
    r, theta = np.sqrt(rng.random(3000)), rng.uniform(0, 2 * np.pi, 3000)
    end = np.stack([0.17 * r * np.cos(theta), 0.12 + 0.12 * r * np.sin(theta)], axis=1)
    ends = [np.column_stack([end, np.full(len(end), z)]) for z in (-0.25, 0.25)]
    assert find_supporting_plane(np.concatenate([torso(rng, 7500), *ends])) is None


def test_few_or_misshapen_points():
    refuses(InputError, "100 at least", find_supporting_plane, np.zeros((5, 3)))
    refuses(InputError, "transposed", find_supporting_plane, np.zeros((3, 500)))
