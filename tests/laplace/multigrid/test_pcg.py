"""Vector kernels, the operator and conjugate gradients, against dense algebra."""

import numpy as np
import pytest

from tests.laplace.multigrid.conftest import noise, split
from ttus_opt.laplace.multigrid.pcg import Vectors, dot, extend, operate, step
from ttus_opt.laplace.multigrid.red_black import BLACK, RED


def test_vector_kernels_by_numpy():
    rng = np.random.default_rng(0)
    n_r, width = 3, 16
    size = n_r * width
    work = rng.normal(size=4 * size).astype(np.float32)
    e, r, p, q = np.split(work.astype(float).copy(), 4)
    sums = np.zeros(n_r)
    dot(work, 0, size, sums, width, (0, 1))
    assert sums.sum() == pytest.approx(float(e @ r), rel=1e-6)
    step(work, (0, size, 2 * size, 3 * size), 0.25, sums, width, (0, 1))
    rest = sums.sum()
    np.testing.assert_allclose(work[:size], e + 0.25 * p, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(work[size : 2 * size], r - 0.25 * q, atol=1e-6)
    assert rest == pytest.approx(float((r - 0.25 * q) @ (r - 0.25 * q)), rel=1e-5)
    extend(work, 2 * size, 3 * size, 0.5, size, (0, 1))
    np.testing.assert_allclose(work[2 * size : 3 * size], q + 0.5 * p, atol=1e-6)


def test_operate_is_A_and_its_energy(small):
    h, layout = small.hierarchy, small.hierarchy.levels[0].layout
    x = noise(small.free)
    size = layout.colour_size
    work = Vectors(h)
    at = work.index
    work.x[:] = split(layout, x)
    energy, sums = 0.0, np.zeros(layout.shape[0])
    for c in (RED, BLACK):
        vectors = at.b + c * size, at.x + c * size, at.x + (1 - c) * size
        operate(h.table[0], h.fields, work.values, c, vectors, sums, (0, 1))
        energy += sums.sum()
    out = work.b.reshape(-1)[layout.places(np.nonzero(small.free))]
    free = small.free.reshape(-1)
    exact = np.ones(int(free.sum()), dtype=bool)
    if small.grid.shape[1] % 2:  # neighbours across the seam have one colour
        j = np.nonzero(small.free)[1]
        exact = (j > 0) & (j < small.grid.shape[1] - 1)
    np.testing.assert_allclose(
        out[exact], (small.A @ x)[free][exact], rtol=1e-4, atol=1e-5
    )
    if exact.all():
        assert energy == pytest.approx(float(x @ small.A @ x), rel=1e-5)


@pytest.mark.parametrize("goal", [1e-1, 1e-4])
def test_a_correction_solves_to_the_accuracy_asked_for(small, goal):
    layout, b = small.hierarchy.levels[0].layout, noise(small.free, 1)
    work = Vectors(small.hierarchy)
    work.b[:] = split(layout, b)
    work.b.reshape(-1)[_beside(small)] = 0.0
    spent = work.correct(goal, 50)
    free = small.free.reshape(-1)
    e = np.zeros(free.size)
    places = layout.places(np.nonzero(small.free))
    e[free] = work.answer.reshape(-1)[places]
    rest = b - small.A @ e
    assert 0 < spent < 15
    assert np.linalg.norm(rest) <= 3.0 * goal * np.linalg.norm(b)
    work.b[:] = split(layout, b)
    work.b.reshape(-1)[_beside(small)] = 0.0
    assert work.correct(1e-30, 2) == 2  # no more V-cycles than allowed


def _beside(small):
    """Places that hold no free node, the copies where the circle closes among them."""
    layout = small.hierarchy.levels[0].layout
    used = layout.places(np.nonzero(small.free))
    return np.setdiff1d(np.arange(2 * layout.colour_size), used)
