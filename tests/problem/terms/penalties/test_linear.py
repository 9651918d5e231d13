"""A plain sum: one gradient, and no curvature."""

import numpy as np

from ttus_opt.problem.terms.penalties.linear import Linear


def test_it_has_one_gradient_whatever_the_residual():
    phi, r = Linear(), np.array([0.5, -2.0])
    assert phi.value(r) == -1.5
    for g in (phi.subgradient(r), phi.admissible(r), phi.resolvent(r, 0.3)[0]):
        np.testing.assert_array_equal(g, [1.0, 1.0])
    assert not phi.resolvent(r, 0.3)[1].factor.any()
    # sup g r − r is bounded at g = 1 alone
    assert phi.conjugate(np.ones(2)) == 0.0
