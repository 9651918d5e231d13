"""What the dual reads of a program: its minimiser is that of dense least squares."""

import numpy as np
import pytest

from tests.kit import small_scene
from tests.oracles.dense import minimiser
from ttus_opt.problem import formulation
from ttus_opt.solvers.dual.data import DualData

SCENE = small_scene("trilinear", shape=(5, 8, 5), n_poses=4)


def compiled(name):
    return formulation.load(name, SCENE, force_weight=3.0, torque_weight=2.0).compile()


@pytest.mark.parametrize("name", ["eq10", "eq10_hard_boundary", "volume_weighted"])
def test_multipliers_give_the_minimiser(name):
    program = compiled(name)
    data = DualData.of(program)
    system, L = data.system, SCENE.L.toarray()
    base = np.linalg.solve(L, data.b)
    S = np.array([system.apply(e) for e in np.eye(len(data.t))])
    y = np.linalg.solve(S, data.t - system.measure(base))
    p = base + system.response(y)
    # the program itself, given values held
    fixed = np.zeros(len(p), dtype=bool)
    if program.dirichlet is not None:
        fixed = ~program.laplace.free
    value = np.where(fixed, data.b, 0.0)
    free = minimiser(program)[~fixed]
    np.testing.assert_allclose(p[~fixed], free, atol=1e-8 * np.abs(free).max())
    np.testing.assert_allclose(p[fixed], value[fixed], atol=1e-12)


def test_priors_that_are_none():
    assert compiled("total_variation").laplace_prior is None
    plain, weighted = compiled("eq10"), compiled("volume_weighted")
    prior, scaled = plain.laplace_prior, weighted.laplace_prior
    assert prior.laplace_rows.scale is None and plain.dirichlet is None
    scale, values = scaled.laplace_rows.scale, weighted.dirichlet.lower
    assert scale is not None and (scale > 0.0).all()
    assert values is not None and len(values) == int((~SCENE.laplace.free).sum())
