"""Depth profiles, and the ranges of a depth map's values."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, refuses
from ttus_opt.problem.terms.depth_profile import (
    DepthProfile,
    check_depth_map,
    depth_map_limits,
    voxel_depths,
)
from ttus_opt.voxmap.grid import CylindricalGrid


def test_it_is_a_sum_of_powers_and_odd():
    profile = DepthProfile((1.0, 2.0), (3.0, 0.5))
    depth = np.array([[-0.02, 0.0], [0.01, 0.03]])
    np.testing.assert_allclose(profile(depth), [[-8.0, 0.0], [3.5, 13.5]])


@pytest.mark.parametrize(
    ("exponents", "coefficients", "word"),
    [
        ((1.0,), (1.0, 2.0), "one coefficient per exponent"),
        ((), (), "one coefficient per exponent"),
        ((0.0,), (1.0,), "exponents must be positive"),
        ((1.0,), (0.0,), "one positive"),
        ((1.0, 2.0), (1.0, -1.0), "must not be negative"),
        ((1.0,), (float("nan"),), "must not be negative"),
    ],
)
def test_bad_profiles_are_refused(exponents, coefficients, word):
    refuses(InputError, word, DepthProfile, exponents, coefficients)


def test_a_depth_counts_by_the_square_of_the_cosine_of_the_slope():
    z = np.linspace(0.0, 0.3, 7)
    cone = np.repeat(0.08 + 0.3 * (z[None] - 0.1), 36, axis=0)
    voxmap = tt.Voxmap.from_surface(tt.Surface.from_radius(cone, z), shape=(12, 36, 7))
    along = (voxmap.spoke_radius - voxmap.grid.r[:, None, None]).ravel()
    np.testing.assert_allclose(voxel_depths(voxmap), along / (1.0 + 0.3**2))


GRID = CylindricalGrid(0.03, 0.13, 0.0, 0.4, (11, 36, 21))
LIMITS = depth_map_limits(GRID)


def matern(distance, length):
    scaled = np.sqrt(3.0) * distance / length
    return float((1.0 + scaled) * np.exp(-scaled))


def test_below_the_least_length_neighbours_are_independent():
    least = LIMITS["depth_length"][0]
    assert matern(GRID.r_step, least) == pytest.approx(0.0077, abs=2e-4)
    nearest = min(GRID.z_step, GRID.theta_step * GRID.r_inner)
    assert matern(nearest, LIMITS["surface_length"][0]) < 0.01


def test_beyond_the_largest_a_field_is_one_constant():
    assert LIMITS["depth_length"][1] == pytest.approx(0.1)
    assert LIMITS["surface_length"][1] == pytest.approx(2.0 * np.pi * 0.13)


@pytest.mark.parametrize("name", ["deviation", "surface_length", "depth_length"])
@pytest.mark.parametrize("value", [0.0, -0.1, 1e-5, 1e3, float("nan")])
def test_others_are_refused_by_name(name, value):
    with pytest.raises(InputError, match=f"^{name} must lie between"):
        check_depth_map(GRID, **{name: value})


def test_what_is_found_by_evidence_is_not_asked_for():
    check_depth_map(GRID)
    check_depth_map(GRID, deviation=0.4, surface_length=0.03, depth_length=0.015)
