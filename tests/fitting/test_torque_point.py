"""The point torques were measured about, from wrenches that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ttus_opt.fitting.torque_point import torque_offset

RNG = np.random.default_rng(0)
N = 30
TURN = Rotation.random(N, rng=1).as_matrix()
FORCE = RNG.normal(0.0, 3.0, (N, 3))
EXPECTED = RNG.normal(0.0, 0.1, (N, 3))


@pytest.mark.parametrize("factor", [1.0, 7.0])
def test_an_offset_is_found_beside_any_factor(factor: float) -> None:
    c = np.array([0.01, -0.03, 0.08])
    torque = factor * EXPECTED - np.cross(TURN @ c, FORCE)
    assert torque_offset(torque, EXPECTED, FORCE, TURN) == pytest.approx(c)
    assert torque_offset(factor * EXPECTED, EXPECTED, FORCE, TURN) == pytest.approx(
        np.zeros(3), abs=1e-12
    )


def test_pushes_along_one_axis_tell_nothing_along_it() -> None:
    force = 3.0 * TURN[:, :, 2]
    c = np.array([0.01, -0.03, 0.08])
    torque = -np.cross(TURN @ c, force)
    found = torque_offset(torque, np.zeros((N, 3)), force, TURN)
    assert found == pytest.approx([0.01, -0.03, 0.0])
