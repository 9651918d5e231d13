"""What a penalty states by itself, and slopes of groups by dense matrices."""

import math
from typing import Any

import numpy as np
import pytest

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.penalties.absolute import Absolute
from ttus_opt.problem.terms.penalties.base import Penalty, Slope
from ttus_opt.problem.terms.penalties.groups import Groups
from ttus_opt.problem.terms.penalties.huber import Huber
from ttus_opt.problem.terms.penalties.linear import Linear
from ttus_opt.problem.terms.penalties.squares import Squares


class Fourth(Penalty):
    """Σ r⁴/4, with what has to be stated and no more."""

    formula = "Σ r⁴/4"

    def value(self, r: Array) -> float:
        return float((r**4).sum()) / 4.0

    def subgradient(self, r: Array) -> Array:
        return np.asarray(r**3)

    def admissible(self, g: Array) -> Array:
        return g

    def conjugate(self, g: Array) -> float:
        return 0.75 * float((np.abs(g) ** (4.0 / 3.0)).sum())

    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        return cp.sum(cp.power(r, 4)) / 4.0


def test_what_is_not_stated_claims_nothing():
    phi = Fourth()
    assert phi.rows_per_group == 1 and phi.split is None
    assert not phi.quadratic and not phi.smooth
    assert phi.gauge(np.ones(3)) == phi.farthest(1.0) == math.inf
    with pytest.raises(InputError, match="Fourth does not implement resolvent"):
        phi.resolvent(np.ones(3), 1.0)


@pytest.mark.parametrize("size", [1, 2, 3])
def test_a_slope_is_the_matrix_it_stands_for(size):
    """Factor times I − n nᵀ, group by group."""
    rng = np.random.default_rng(0)
    factor = np.repeat(rng.uniform(0.1, 2.0, 6 // size), size)
    along = rng.normal(size=(6 // size, size))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    slope = Slope(factor, along.reshape(-1), size)
    dense = np.zeros((6, 6))
    for k, n in enumerate(along):
        at = slice(k * size, (k + 1) * size)
        dense[at, at] = factor[k * size] * (np.eye(size) - np.outer(n, n))
    found = np.column_stack([slope.times(unit) for unit in np.eye(6)])
    np.testing.assert_allclose(found, dense, atol=1e-14)
    plain = np.column_stack([Slope(factor).times(unit) for unit in np.eye(6)])
    np.testing.assert_array_equal(plain, np.diag(factor))


@pytest.mark.parametrize(
    "phi", [Squares(), Huber(0.5), Absolute(), Groups(2), Linear()], ids=repr
)
def test_smooth_is_what_has_one_slope_everywhere(phi):
    """Along a line through zero; quadratic penalties need not say so."""
    along = np.array([1.0, -0.7])
    r = np.linspace(-1.5, 1.5, 3002)[:, None] * along
    jumps = np.abs(np.diff([phi.subgradient(each) for each in r], axis=0)).max()
    assert (jumps < 0.01) == (phi.smooth or phi.quadratic)
