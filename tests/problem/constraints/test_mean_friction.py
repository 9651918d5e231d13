"""Limits of the mean friction coefficient."""

from tests.problem.constraints.declared import SCENE, bounds
from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.problem.constraints.mean_friction import MeanFriction


def test_the_mean_lies_between_nothing_and_the_largest():
    mean = bounds(MeanFriction(SCENE, 0.4).rows())
    assert (mean.variable, mean.lower, mean.upper) == ("m", [0.0], [0.4])


def test_a_mean_that_is_none_is_refused():
    refuses(InputError, "largest friction must lie between", MeanFriction, SCENE, -1.0)
