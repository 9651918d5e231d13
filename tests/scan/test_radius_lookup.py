"""The one lookup of the surface's radius, against plain bilinear interpolation."""

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ttus_opt as tt
from tests.kit import torso
from ttus_opt.scan.radius_lookup import radius_between, radius_cell

BASE = torso(n_theta=37, n_z=11)


@numba.njit
def look(theta, z, n_theta, n_z, layout, flat):
    here, after, a, b = radius_cell(theta, z, n_theta, n_z, layout)
    return radius_between(here, after, a, b, flat)


def turned(first_angle):
    return tt.Surface(
        BASE.theta + first_angle,
        BASE.z,
        BASE.radius,
        BASE.radius_std,
        BASE.observed,
        tt.Axis.identity(),
    )


def plain(surface, theta, z):
    """Bilinear between the nodes, one turn after the other; ends go on."""
    turns = np.concatenate([surface.theta + 2 * np.pi * n for n in range(-3, 4)])
    along = [
        np.interp(theta, turns, np.tile(surface.radius[:, k], 7))
        for k in range(len(surface.z))
    ]
    return float(np.interp(z, surface.z, along))


@pytest.mark.slow
@given(
    st.floats(0.0, 2 * np.pi, exclude_max=True),
    st.floats(-0.1, 0.3),
    st.sampled_from([0.0, 0.01, 3.0, -np.pi, 6.2, 9.0]),
)
def test_equals_the_surface(theta, z, first_angle):
    surface = turned(first_angle)
    found = look(
        theta,
        z,
        *surface.radius.shape,
        surface.kernel_layout,
        surface.radius.reshape(-1),
    )
    assert found == float(surface.radius_at(np.array(theta), np.array(z)))
    assert abs(found - plain(surface, theta, z)) < 1e-13
    beside = surface.radius_at(theta + 2 * np.pi * np.array([-2, -1, 1]), np.array(z))
    np.testing.assert_allclose(beside, found, rtol=0, atol=1e-13)
