"""The split lookup is the surface's own bilinear radius, to the last bit."""

from __future__ import annotations

import numba
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.conftest import torso
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.surface_kernels import skin_between, skin_cell, skin_layout

BASE = torso(n_theta=37, n_z=11)


@numba.njit
def look(
    theta: float, z: float, n_theta: int, n_z: int, layout: np.ndarray, flat: np.ndarray
) -> float:
    here, after, a, b = skin_cell(theta, z, n_theta, n_z, layout)
    return skin_between(here, after, a, b, flat)


def turned(first_angle: float) -> Surface:
    return Surface(
        BASE.theta + first_angle,
        BASE.z,
        BASE.radius,
        BASE.radius_std,
        BASE.observed,
        Axis.identity(),
    )


@settings(deadline=None)
@given(
    st.floats(0.0, 2 * np.pi, exclude_max=True),
    st.floats(-0.1, 0.3),
    st.sampled_from([0.0, 0.01, 3.0, -np.pi, 6.2, 9.0]),
)
def test_equals_the_surface(theta: float, z: float, first_angle: float) -> None:
    surface = turned(first_angle)
    found = look(
        theta,
        z,
        *surface.radius.shape,
        skin_layout(surface),
        surface.radius.reshape(-1),
    )
    expected = float(surface.radius_at(np.array(theta), np.array(z)))
    if 0.0 <= first_angle < 2 * np.pi:
        assert found == expected
    else:  # the first angle itself was brought into the turn
        assert abs(found - expected) < 1e-14
