"""No negative value where a probe may come."""

import numpy as np

from tests.problem.constraints.declared import REGION, SCENE, bounds
from ttus_opt.problem.constraints.nonnegative import NonNegative
from ttus_opt.voxmap.voxmap import OUTSIDE


def test_touched_voxels_are_not_negative():
    flat, touch = REGION.reshape(-1), bounds(NonNegative(SCENE).rows())
    np.testing.assert_array_equal(np.isfinite(touch.lower), flat != OUTSIDE)
    assert not np.isfinite(touch.upper).any()
