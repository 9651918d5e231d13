"""Thinned recordings."""

import numpy as np
import pytest

from tests.conftest import presses, torso
from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.probe.thinning import thinned
from ttus_opt.probe.trajectory import Trajectory

ONE = presses(torso(), 30, np.random.default_rng(0))  # every 0.05 s
TWO = Trajectory.concatenate([ONE, ONE.select(slice(1, None))])


def test_every_counts_in_each_recording():
    left = thinned(TWO, every=10)
    assert left.time.tolist() == pytest.approx([0, 0.5, 1.0, 0.05, 0.55, 1.05])
    assert left.segment.tolist() == [0, 0, 0, 1, 1, 1]
    np.testing.assert_array_equal(left.force, TWO.force[[0, 10, 20, 30, 40, 50]])


@pytest.mark.parametrize(
    ("rate", "expected"), [(4.0, 6), (20.0, 30), (1e4, 30), (7.0, 11), (0.1, 1)]
)
def test_rate_is_the_most_frames_a_second(rate, expected):
    assert len(thinned(ONE, rate=rate)) == expected


def test_both_together():
    assert thinned(ONE, rate=10.0, every=5).time.tolist() == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("every", [0, -1, 1.5])
def test_every_is_a_count(every):
    refuses(InputError, "every", thinned, ONE, every=every)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_rate_is_positive(rate):
    refuses(InputError, "rate", thinned, ONE, rate=rate)
