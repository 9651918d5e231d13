"""Shares of contact patches add up to 1 and are continuous."""

import numpy as np
import pytest

from tests.conftest import torso
from ttus_opt.comparators.patch_law import AROUND, HEIGHT, PatchGrid


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
