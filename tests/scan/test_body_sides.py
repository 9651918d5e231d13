"""Head from feet and front from back, by points alone."""

import numpy as np
import pytest

from ttus_opt.core.errors import TtusWarning
from ttus_opt.scan.body_sides import front_along, head_along

RNG = np.random.default_rng(0)
Z = RNG.uniform(-0.3, 0.3, 20_000)
ANGLE = RNG.uniform(0.0, 2 * np.pi, Z.size)


def test_the_deeper_end_is_the_head():
    """Seen all around, the back may fall as the front rises: depth counts."""
    depth = (0.10 + 0.02 * Z) * np.sin(ANGLE) - 0.3 * Z
    assert head_along(Z, depth, supported=False) == 1.0
    assert head_along(-Z, depth, supported=False) == -1.0
    assert head_along(Z, -depth, supported=False) == 1.0
    height = 0.2 + 0.03 * Z + 0.01 * np.sin(ANGLE)
    assert head_along(Z, height, supported=True) == 1.0
    assert head_along(-Z, height, supported=True) == -1.0


def test_ends_and_gaps_do_not_count():
    """A cut end or a shoulder, and sections that no camera saw."""
    height = 0.2 + 0.03 * Z
    height[Z > 0.26] = 0.05
    seen = np.abs(Z) > 0.05
    assert head_along(Z[seen], height[seen], supported=True) == 1.0


def test_the_flatter_side_is_the_back():
    front = np.where(np.sin(ANGLE) > 0, np.sin(ANGLE), 0.3 * np.sin(ANGLE))
    assert front_along(front) == 1.0
    assert front_along(-front) == -1.0


def test_a_guess_is_said():
    with pytest.warns(TtusWarning, match="which end is the head"):
        head_along(Z, 0.1 * np.sin(ANGLE), supported=False)
    with pytest.warns(
        TtusWarning, match="which end is the head"
    ):  # nearly nothing seen
        head_along(Z[:20], Z[:20], supported=True)
    with pytest.warns(TtusWarning, match="which side is the front"):
        front_along(np.sin(ANGLE))
