"""Rows of a field over some of its voxels."""

import numpy as np
import scipy.sparse as sp

from ttus_opt.fitting.uncertainty.posterior import kept_rows


def test_blocks_that_touch_other_voxels_are_told():
    for voxels in (4, 9):  # fewer blocks than voxels, or about as many
        rows = sp.csr_array(np.eye(voxels)[[0, 2, 3, 1, 2, 0]])
        kept, missing = kept_rows(rows, np.array([0, 2]), 2)
        assert missing.tolist() == [False, True, False]
        np.testing.assert_array_equal(kept.toarray()[:2], np.eye(2))
        np.testing.assert_array_equal(kept.toarray()[4:], np.eye(2)[::-1])
