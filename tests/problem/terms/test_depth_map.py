"""The term of a depth map."""

from dataclasses import replace

import numpy as np
import pytest

from tests.kit import InputError, refuses, small_scene
from ttus_opt.problem.terms.depth_map import SCALE_DEVIATION, DepthMapTerm
from ttus_opt.problem.terms.depth_map_estimate import PRIOR, DepthMapEstimate
from ttus_opt.problem.terms.depth_profile import DepthProfile, voxel_depths

PROFILE = DepthProfile((1.0, 2.0), (0.8, 0.3))


def term(**options):
    return DepthMapTerm(small_scene("trilinear"), profile=PROFILE, **options)


def test_the_profile_costs_nothing_and_grows_inwards():
    one = term()
    rows = one.assembled
    assert np.abs(rows.blocks["p"] @ one.mean - rows.target).max() < 1e-9
    field = one.mean.reshape(one.scene.voxmap.grid.shape)
    assert (np.diff(field, axis=0) < 0.0).all()
    assert (field[one.scene.voxmap.inside] > 0.0).all()
    assert (one.mean > 0.0).sum() == (voxel_depths(one.scene.voxmap) > 0.0).sum()


def test_a_field_with_twice_the_deviation_costs_four_times_as_much():
    one = term()
    rows = one.assembled
    g = np.random.default_rng(1).normal(size=len(one.mean))
    costs = [
        float(np.sum((rows.blocks["p"] @ (one.mean * (1 + s * g)) - rows.target) ** 2))
        for s in (1.0, 2.0)
    ]
    assert costs[1] == pytest.approx(4.0 * costs[0])
    wider = term(deviation=0.8).assembled
    cost = np.sum((wider.blocks["p"] @ (one.mean * (1 + g)) - wider.target) ** 2)
    assert cost == pytest.approx(costs[0] / 4.0)


def test_the_mean_drifts_by_its_scale_and_its_exponents():
    """By differences: the prior of an exponent is one of its logarithm."""
    one, h = term(), 1e-5
    scale, *powers = one._uncertain_mean().drift.T
    np.testing.assert_allclose(scale, SCALE_DEVIATION * one.mean)
    assert len(powers) == len(PROFILE.exponents)
    for j, power in enumerate(powers):
        more, less = (
            term_of(np.exp(sign * h * np.eye(len(powers))[j])) for sign in (1, -1)
        )
        slope = (more.mean - less.mean) / (2.0 * h)
        np.testing.assert_allclose(
            power, PRIOR["exponent"][1] * slope, rtol=1e-6, atol=1e-8 * abs(slope).max()
        )


def term_of(factors):
    """A term whose exponents are times these."""
    exponents = tuple(factors * PROFILE.exponents)
    return replace(term(), profile=replace(PROFILE, exponents=exponents))


@pytest.mark.parametrize("name", ["deviation", "surface_length", "depth_length"])
@pytest.mark.parametrize(
    "value", [0.0, -1.0, float("nan"), float("inf"), 1e-300, 1e-9, 1e9]
)
def test_bad_options_are_refused(name, value):
    with pytest.raises(InputError, match=f"{name} must lie between .*, got {value}"):
        term(**{name: value})


ESTIMATED = DepthMapEstimate(
    *(1.0, 0.02, 0.3, 0.011),
    length_ratio=2.0,
    profile=PROFILE,
    noise=0.1,
    log_evidence=0.0,
)


def test_a_term_has_the_estimated_values():
    scene = small_scene("trilinear")
    found = DepthMapTerm.of(scene, ESTIMATED)
    expected = DepthMapTerm(
        scene,
        profile=PROFILE,
        deviation=0.3,
        surface_length=0.02,
        depth_length=0.011,
        length_ratio=2.0,
    )
    assert found == expected


def test_the_formula_has_a_length_for_each_direction():
    formula = term(surface_length=0.03, length_ratio=4.0).formula
    assert formula == (
        "‖R (p/φ − 1)‖²/σ², φ = 0.8 (d/10 mm)^1 + 0.3 (d/10 mm)^2, σ = 0.4, lengths "
        "60 mm around, 15 along, 15 deep"
    )


class Wrong(DepthMapTerm):
    """Declares the covariance of other rows."""

    def rows(self):
        rows = super().rows()
        return replace(rows, blocks={"p": rows.blocks["p"] * 1.01})


def test_a_covariance_that_is_not_that_of_the_rows_is_refused():
    wrong = Wrong(small_scene("trilinear"), profile=PROFILE)
    refuses(InputError, "drop the tag KnownCovariance", lambda: wrong.assembled)
