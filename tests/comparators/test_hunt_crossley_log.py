"""The law of the logarithm finds the numbers its data were made with."""

import math

import numpy as np
import pytest

from tests.comparators.contacts import NO_PATCH, STILL, contacts, made, samples
from ttus_opt.comparators.hunt_crossley_log import HuntCrossleyLog
from ttus_opt.comparators.patch_model import Contact


def test_the_logarithm_finds_the_same_where_damping_is_small():
    rng = np.random.default_rng(4)
    found = contacts(800, rng, rate=0.2)
    forces = np.array([6.0 * c.depth**1.7 * (1.0 + 0.1 * c.rate) for c in found])
    law = made(HuntCrossleyLog)
    law._fit_law(samples(found, forces))
    expected = [math.log(6.0), 1.7, 0.1]
    np.testing.assert_allclose(law.per_patch.mean(axis=0), expected, rtol=0.02)
    fast = Contact(0.8, 3.0, found[0].place, STILL, NO_PATCH)
    assert law._normal_force(fast) == pytest.approx(6.0 * 0.8**1.7 * 1.3, rel=0.03)


def test_a_fast_retreat_does_not_pull():
    law = HuntCrossleyLog._law
    back = Contact(0.8, -30.0, np.zeros(3), STILL, NO_PATCH)
    assert law(made(HuntCrossleyLog), np.array([math.log(6.0), 1.7, 0.1]), back) == 0.0
