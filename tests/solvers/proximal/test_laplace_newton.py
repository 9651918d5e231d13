"""Newton steps through the dual against dense algebra."""

import numpy as np
import pytest

from tests.solvers.proximal import dense_steps
from ttus_opt.problem.terms.penalties import Slope
from ttus_opt.solvers.proximal.laplace_newton import LaplaceNewton


@pytest.mark.parametrize("name", ["robust", "sparse_sources"])
@pytest.mark.parametrize("bent", [0.0, 0.4, 1.0])
def test_through_the_dual(name, bent):
    """Few rows may all have bent; of Laplace's rows it is squares that are meant."""
    problem = dense_steps.problem_of(name)
    slopes = dense_steps.slopes_of(problem, 0, bent)
    for k, b in enumerate(problem.blocks):
        if b.laplace is not None:
            factor = slopes[k].factor
            slopes[k] = Slope(np.where(factor > 0.0, factor, factor.max() + 1e-2))
    system = LaplaceNewton(problem)
    gradient = dense_steps.gradient_of(problem)
    step, _ = system.step(
        gradient, dense_steps.none_of(problem), slopes, dense_steps.RTOL, None
    )
    dense_steps.compared(step, dense_steps.expected(problem, slopes, gradient))


def test_heavy_rows_balance_the_others():
    """A rough step is rough beside the step, not beside what heavy rows pull at."""
    problem = dense_steps.problem_of("robust")
    slopes = dense_steps.slopes_of(problem, 0, 0.0)
    few = [k for k, b in enumerate(problem.blocks) if b.laplace is None]
    for k in few:
        slopes[k] = Slope(1e8 * slopes[k].factor)
    system = LaplaceNewton(problem)
    rng, x = np.random.default_rng(8), np.zeros(len(problem.fixed))
    residuals = [rng.normal(size=len(b.target)) for b in problem.blocks]
    for k, b in enumerate(problem.blocks):
        if b.laplace is not None:
            residuals[k][:] = 0.0
    first = None
    for _ in range(2):  # the second one mends what the first left
        y = [
            s.factor * (r + b.matrix @ x)
            for b, s, r in zip(problem.blocks, slopes, residuals, strict=True)
        ]
        gradient = np.sum(
            [b.adjoint(own) for b, own in zip(problem.blocks, y, strict=True)], axis=0
        )
        exact = dense_steps.expected(problem, slopes, gradient)
        step, _ = system.step(gradient, y, slopes, 1e-4, None)
        system.taken(1.0)
        first = exact if first is None else first
        np.testing.assert_allclose(step, exact, atol=1e-3 * np.abs(first).max())
        x = x + step
        assert gradient @ step < 0.0
