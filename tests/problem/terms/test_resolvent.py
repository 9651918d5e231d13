"""Resolvents of penalties: optimal as they claim, their slopes by differences."""

import numpy as np
import pytest

from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.penalties.absolute import Absolute
from ttus_opt.problem.terms.penalties.base import Penalty
from ttus_opt.problem.terms.penalties.groups import Groups
from ttus_opt.problem.terms.penalties.huber import Huber
from ttus_opt.problem.terms.penalties.linear import Linear
from ttus_opt.problem.terms.penalties.squares import Squares

PENALTIES = [Squares(), Absolute(), Huber(0.4), Groups(3), Linear()]
V = np.random.default_rng(0).normal(0.0, 2.0, 30)


@pytest.mark.parametrize("step", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("penalty", PENALTIES, ids=lambda p: type(p).__name__)
def test_a_resolvent_splits_v_into_a_residual_and_its_subgradient(penalty, step):
    """v = g + step z with g a subgradient at z, by Fenchel's equality."""
    g, _ = penalty.resolvent(V, step)
    z = (V - g) / step
    np.testing.assert_allclose(penalty.admissible(g), g, rtol=0, atol=1e-12)
    missing = penalty.value(z) + penalty.conjugate(g) - g @ z
    assert abs(missing) <= 1e-9 * (1.0 + abs(penalty.value(z)))


@pytest.mark.parametrize("penalty", PENALTIES, ids=lambda p: type(p).__name__)
def test_a_slope_is_the_resolvents_derivative(penalty):
    along = np.random.default_rng(1).normal(size=len(V))
    ends = [penalty.resolvent(V + side * 1e-6 * along, 0.7)[0] for side in (1.0, -1.0)]
    _, slope = penalty.resolvent(V, 0.7)
    expected = (ends[0] - ends[1]) / 2e-6
    np.testing.assert_allclose(slope.times(along), expected, rtol=0, atol=1e-7)


def test_a_penalty_without_a_resolvent_says_so():
    class Mute(Absolute):
        resolvent = Penalty.resolvent

    refuses(InputError, "Mute does not implement resolvent", Mute().resolvent, V, 1.0)
