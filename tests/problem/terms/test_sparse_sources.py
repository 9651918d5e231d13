"""Absolute values put sources into few voxels."""

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.terms.sparse_sources import SparseSourcesTerm

SCENE = small_scene("trilinear", n_poses=20)


@pytest.mark.slow
def test_sparse_sources_are_sparse():
    """Squares spread sources over the voxels, absolute values put them into few."""
    options = {"force_weight": 10.0, "torque_weight": 10.0}
    spread = fit(SCENE, "eq10_hard_boundary", **options)
    few = fit(SCENE, "sparse_sources", sparsity=1e-2, tolerance=1e-7, **options)
    term = SparseSourcesTerm(SCENE).rows()

    def active(field):
        source = np.abs(term.blocks["p"] @ field.values.reshape(-1) - term.target)
        return int((source > 1e-4 * source.max()).sum())

    assert 0 < active(few.field) < 0.2 * active(spread.field)
