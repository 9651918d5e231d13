"""Weights of a path: every point once, in an order that pays; bad weights refused."""

import itertools

import numpy as np
import pytest

from tests.kit import InputError, refuses
from ttus_opt.fitting.path.weight_grid import WeightGrid

TERMS = ("laplace", "force", "torque")


@pytest.mark.parametrize("shape", [(3, 4), (2, 5), (1, 2)])
def test_every_point_comes_once(shape):
    force, torque = (np.arange(1, n + 1) for n in shape)
    grid = WeightGrid.of({"force": force, "torque": torque}, TERMS)
    every = set(itertools.product(*map(range, shape)))
    for order in (grid.from_both_ends(), grid.from_the_prior()):
        assert len(order) == grid.size == shape[0] * shape[1]
        assert set(order) == every


def test_neighbours_follow_each_other_from_the_smallest_on():
    grid = WeightGrid.of({"force": [4, 2, 1], "torque": [5, 7]}, TERMS)
    order = np.array(grid.from_the_prior())
    assert (np.abs(np.diff(order, axis=0)).sum(axis=1) == 1).all()
    assert grid.at((0, 0)) == {"force": 1.0, "torque": 5.0}


def test_the_ends_come_first():
    grid = WeightGrid.of({"force": np.arange(1, 10), "torque": np.arange(1, 10)}, TERMS)
    first = grid.from_both_ends()[:4]
    assert set(first) == set(itertools.product((0, 8), repeat=2))


def test_terms_may_share_a_weight():
    grid = WeightGrid.of({("force", "torque"): [1e-2, 1.0]}, TERMS)
    assert grid.at((1,)) == {"force": 1.0, "torque": 1.0}
    assert grid.axes[0].dimension == "force_weight"


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        ({}, "values by term"),
        ([1.0], "values by term"),
        ({"forse": [1.0]}, "no term 'forse'"),
        ({"force": [1.0], ("torque", "force"): [1.0]}, "two lists"),
        ({"force": [0.0, 1.0]}, "positive"),
        ({"force": [-1.0]}, "positive"),
        ({"force": [np.nan]}, "positive"),
        (
            {("force", "torque"): np.array([np.nan, 1.0, -2.0])},
            "the weights of force and torque must be positive numbers, got nan, -2:",
        ),
        ({"force": []}, "positive"),
        ({"force": [[1.0, 2.0]]}, "positive"),
        ({"force": "many"}, "numbers"),
        ({"force": [2.0, 1.0, 2.0]}, "differ from each other, got 2 repeatedly"),
        ({(): [1.0]}, "term"),
        ({"force": np.arange(1, 1000), "torque": np.arange(1, 1000)}, "at most"),
    ],
)
def test_bad_weights_are_one_line(weights, words):
    told = refuses(InputError, words, WeightGrid.of, weights, TERMS)
    assert not any(code in told for code in ("array(", "('", "np."))
