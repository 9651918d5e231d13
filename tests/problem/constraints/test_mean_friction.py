"""Limits of the mean friction coefficient."""

from __future__ import annotations

import pytest

from tests.problem.constraints.declared import SCENE, bounds
from ttus_opt.core.errors import InputError
from ttus_opt.problem.constraints.mean_friction import MeanFriction


def test_the_mean_lies_between_nothing_and_the_largest() -> None:
    mean = bounds(MeanFriction(SCENE, 0.4).rows())
    assert (mean.variable, mean.lower, mean.upper) == ("m", [0.0], [0.4])


def test_a_mean_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="largest friction must lie between"):
        MeanFriction(SCENE, -1.0)
