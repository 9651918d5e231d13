"""Boundary values that are kept exactly."""

import numpy as np

from tests.problem.constraints.declared import REGION, SCENE, linear
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.constraints.boundary import HardBoundary


def test_hard_boundary_keeps_the_values():
    rows = linear(HardBoundary(SCENE).rows())
    np.testing.assert_array_equal(rows.lower, rows.upper)
    hard = fit(SCENE, "eq10_hard_boundary", force_weight=3.0)
    fixed = SCENE.voxmap.dirichlet
    np.testing.assert_allclose(
        hard.field.values[fixed], SCENE.b.reshape(REGION.shape)[fixed], atol=1e-9
    )
    soft = fit(SCENE, "eq10", force_weight=3.0)
    assert hard.objective > soft.objective
