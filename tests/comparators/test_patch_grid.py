"""Shares of contact patches add up to 1 and are continuous."""

from __future__ import annotations

import numpy as np
import pytest

from tests.conftest import torso
from ttus_opt.comparators.patch_grid import AROUND, PatchGrid


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
