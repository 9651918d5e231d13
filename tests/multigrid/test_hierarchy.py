"""A hierarchy holds its coefficients once."""

from __future__ import annotations

import numpy as np

from ttus_opt.multigrid.hierarchy import Hierarchy
from ttus_opt.voxmap.grid import CylindricalGrid


def test_levels_are_parts_of_one_array() -> None:
    grid = CylindricalGrid(0.03, 0.18, 0.0, 0.3, (17, 32, 16))
    free = np.zeros(grid.shape, dtype=bool)
    free[1:-1, :, 1:-1] = True
    hierarchy = Hierarchy.build(grid, free)
    assert len(hierarchy.levels) > 2
    for level in hierarchy.levels:
        for array in level.arrays:
            assert np.shares_memory(array, hierarchy.fields)
