"""Blocks over some variables, placed over all of them."""

import numpy as np
import pytest
import scipy.sparse as sp

from ttus_opt.problem.stacking import stacked

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    "names", [["a"], ["b"], ["c"], ["a", "c"], ["b", "c"], ["c", "a"], ["a", "b", "c"]]
)
def test_blocks_lie_where_their_variables_do(names):
    sizes = {"a": 3, "b": 4, "c": 2}
    dense = {name: RNG.normal(size=(5, sizes[name])) for name in names}
    for block in dense.values():
        block[RNG.random(block.shape) < 0.4] = 0.0
    blocks = {name: sp.csr_array(block) for name, block in dense.items()}
    nothing = {name: np.zeros((5, size)) for name, size in sizes.items()}
    expected = np.hstack([(nothing | dense)[name] for name in sizes])
    found = stacked(blocks, sizes, 5)
    np.testing.assert_array_equal(found.toarray(), expected)
    assert found.nnz == np.count_nonzero(expected)
    for name, block in dense.items():  # which others may still use
        np.testing.assert_array_equal(blocks[name].toarray(), block)
    assert stacked({}, sizes, 5).shape == (5, 9)
