"""Newton steps by dense algebra, H d = −g on what is not given, and slopes for them."""

import functools

import numpy as np

from tests.kit import small_scene
from ttus_opt.problem import formulation
from ttus_opt.problem.terms.penalties import Slope
from ttus_opt.solvers.proximal.problem import PenalisedProblem

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=3)


RTOL = 1e-10


@functools.cache
def problem_of(name):
    weights = {"force_weight": 0.3, "torque_weight": 0.1}
    program = formulation.load(name, SCENE, **weights).compile()
    return PenalisedProblem.of(program.declared or program)


def slopes_of(problem, seed, bent):
    """Slopes as kinks leave them: some rows have none."""
    rng = np.random.default_rng(seed)
    slopes = []
    for block in problem.blocks:
        m = len(block.target)
        factor = 2.0 * block.weight * rng.uniform(0.5, 2.0, m)
        if not block.exact:
            factor *= rng.uniform(size=m) >= bent
        slopes.append(Slope(factor))
    return slopes


def expected(problem, slopes, gradient):
    """−H⁻¹g by dense algebra."""
    n = len(problem.fixed)
    H = np.zeros((n, n))
    for block, slope in zip(problem.blocks, slopes, strict=True):
        M = block.matrix.toarray()
        C = np.column_stack([slope.times(unit) for unit in np.eye(len(M))])
        H += M.T @ C @ M
    free = np.flatnonzero(~problem.fixed)
    d = np.zeros(n)
    d[free] = np.linalg.solve(H[np.ix_(free, free)], -gradient[free])
    return d


def none_of(problem):
    """No multipliers: the gradient is all there is."""
    return [np.zeros(len(b.target)) for b in problem.blocks]


def compared(step, exact):
    np.testing.assert_allclose(step, exact, atol=1e-7 * np.abs(exact).max())


def gradient_of(problem):
    return np.random.default_rng(3).normal(size=len(problem.fixed))
