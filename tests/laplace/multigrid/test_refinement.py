"""The parts in double precision, on whole grids, against A written down."""

import math

import numpy as np
import pytest

from tests.laplace.multigrid.conftest import noise, split
from ttus_opt.laplace.multigrid.coarsening import conductances
from ttus_opt.laplace.multigrid.refinement import Operator, add, residual


def operator(small):
    sizes = *small.grid.shape[1:], small.hierarchy.levels[0].layout.pitch
    return Operator.of(small.free.reshape(-1), conductances(small.grid), sizes)


@pytest.mark.parametrize("is_zero", [False, True])
def test_the_residual_and_its_norm(small, is_zero):
    x, b = noise(small.free, 1), noise(small.free, 2)
    layout = small.hierarchy.levels[0].layout
    out = np.zeros(layout.stored_shape, np.float32)
    square = residual(out, x, b, operator(small), 4.0, is_zero=is_zero)
    rest = b if is_zero else b - small.A @ x
    assert math.sqrt(square) == pytest.approx(float(np.linalg.norm(rest)), rel=1e-12)
    places = layout.places(np.nonzero(small.free))
    expected = split(layout, 4.0 * rest).reshape(-1)
    np.testing.assert_allclose(out.reshape(-1)[places], expected[places], rtol=1e-6)


def test_add_brings_a_correction_back(small):
    x, e = noise(small.free, 3), noise(small.free, 4)
    correction = split(small.hierarchy.levels[0].layout, e)
    sum_of_squares = add(x, correction, 0.5, operator(small))
    expected = noise(small.free, 3) + 0.5 * e
    np.testing.assert_allclose(x, expected, atol=1e-6)
    assert sum_of_squares == pytest.approx(float(x @ x), rel=1e-12)
