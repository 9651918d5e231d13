"""Second-order cones of a program: projection, multipliers, verification by hand."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import minimize

from ttus_opt.problem.members import ProgramCones, ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.kkt import Duals, kkt_residuals

RNG = np.random.default_rng(0)


def cones(sizes):
    m = sum(sizes)
    eye = sp.csr_array(sp.eye_array(m))
    return ProgramCones("cones", eye, np.zeros(m), sizes)


@pytest.mark.slow
def test_the_projection_is_the_nearest_point():
    """Against a general minimiser; a cone of one row is a sign."""
    one = cones((3,))
    for _ in range(20):
        s = RNG.normal(size=3)
        found = one.projected(s)
        nearest = minimize(
            lambda v, s=s: np.sum((v - s) ** 2),
            [2.0, 0.0, 0.0],
            constraints={
                "type": "ineq",
                "fun": lambda v: v[0] - np.sqrt(v[1] ** 2 + v[2] ** 2 + 1e-18),
            },
            tol=1e-12,
        ).x
        np.testing.assert_allclose(found, nearest, atol=1e-5)
    several = cones((1, 3, 1, 2))
    s = np.array([-2.0, 0.0, 3.0, 4.0, 5.0, -1.0, 0.5])
    expected = [0.0, 2.5, 1.5, 2.0, 5.0, 0.0, 0.0]
    np.testing.assert_allclose(several.projected(s), expected)
    np.testing.assert_allclose(several.slack(s), [-2.0, -5.0, 5.0, -1.5])
    np.testing.assert_allclose(several.admissible(-s), np.negative(expected))


@pytest.mark.parametrize(
    ("x", "y", "optimal"),
    [
        (1.0, (-2.0, 2.0), True),
        (0.0, (0.0, 4.0), False),  # balances the gradient, but is no multiplier
        (0.0, (-4.0, 4.0), False),  # is one, but not of a cone's inside
        (2.0, (0.0, 0.0), False),  # outside the cone
        (1.0, (2.0, 2.0), False),
    ],
)
def test_the_conditions_of_a_cone(x, y, optimal):
    """min (x − 2)² over |x| ≤ 1, said as the cone (1, x)."""
    squares = ProgramTerm("fit", 1.0, sp.csr_array([[1.0]]), np.array([2.0]))
    limit = ProgramCones(
        "limit", sp.csr_array([[0.0], [1.0]]), np.array([1.0, 0.0]), (2,)
    )
    program = Program({"p": slice(0, 1)}, (squares,), (), (), None, (limit,))
    kkt = kkt_residuals(program, np.array([x]), Duals({"limit": np.array(y)}))
    assert (kkt.worst_relative < 1e-12) == optimal
    assert not program.is_quadratic
    assert program.limited_rows == (limit,)
