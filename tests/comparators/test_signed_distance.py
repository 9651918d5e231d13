"""Penalty by signed distance on a block and a ball."""

import numpy as np
import pytest

from tests.comparators.walls import (
    AREA,
    DEPTH,
    block,
    check_cap_of_a_ball,
    pressed,
    wall,
)
from ttus_opt.comparators.signed_distance import SignedDistance


def test_signed_distance_gives_a_block_area_times_depth():
    made = SignedDistance(surface=wall(), shell=block())
    unit, _ = made._unit_wrench(*pressed(DEPTH))
    assert unit[0] == pytest.approx(AREA * DEPTH, rel=0.02)
    # opposite sides of the block cancel to the evenness of its points
    np.testing.assert_allclose(unit[1:], 0.0, atol=0.03 * unit[0])


def test_a_pressed_ball_displaces_its_cap():
    check_cap_of_a_ball(SignedDistance)
