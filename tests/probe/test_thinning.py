"""Thinned recordings."""

from __future__ import annotations

import numpy as np
import pytest

from tests.conftest import presses, torso
from ttus_opt.core.errors import InputError
from ttus_opt.probe.thinning import thinned
from ttus_opt.probe.trajectory import Trajectory

ONE = presses(torso(), 30, np.random.default_rng(0))  # every 0.05 s
TWO = Trajectory.concatenate([ONE, ONE.select(slice(1, None))])


def test_every_counts_in_each_recording() -> None:
    left = thinned(TWO, every=10)
    assert left.time.tolist() == pytest.approx([0, 0.5, 1.0, 0.05, 0.55, 1.05])
    assert left.segment.tolist() == [0, 0, 0, 1, 1, 1]
    np.testing.assert_array_equal(left.force, TWO.force[[0, 10, 20, 30, 40, 50]])


@pytest.mark.parametrize(
    ("rate", "expected"), [(4.0, 6), (20.0, 30), (1e4, 30), (7.0, 11), (0.1, 1)]
)
def test_rate_is_the_most_frames_a_second(rate: float, expected: int) -> None:
    assert len(thinned(ONE, rate=rate)) == expected


def test_both_together() -> None:
    assert thinned(ONE, rate=10.0, every=5).time.tolist() == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("every", [0, -1, 1.5])
def test_every_is_a_count(every: float) -> None:
    with pytest.raises(InputError, match="every"):
        thinned(ONE, every=every)  # type: ignore[arg-type]


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_rate_is_positive(rate: float) -> None:
    with pytest.raises(InputError, match="rate"):
        thinned(ONE, rate=rate)
