"""The curve of a depth map."""

import numpy as np
import pytest

from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.depth_profile import DepthProfile


def test_it_is_a_sum_of_powers_and_odd():
    profile = DepthProfile((1.0, 2.0), (3.0, 0.5))
    depth = np.array([[-0.02, 0.0], [0.01, 0.03]])
    np.testing.assert_allclose(profile(depth), [[-8.0, 0.0], [3.5, 13.5]])


@pytest.mark.parametrize(
    ("exponents", "coefficients", "word"),
    [
        ((1.0,), (1.0, 2.0), "one coefficient per exponent"),
        ((), (), "one coefficient per exponent"),
        ((0.0,), (1.0,), "exponents must be positive"),
        ((1.0,), (0.0,), "one positive"),
        ((1.0, 2.0), (1.0, -1.0), "must not be negative"),
        ((1.0,), (float("nan"),), "must not be negative"),
    ],
)
def test_bad_profiles_are_refused(exponents, coefficients, word):
    refuses(InputError, word, DepthProfile, exponents, coefficients)
