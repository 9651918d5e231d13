"""A box keeps the points inside, sides included, and says what it cannot use."""

import numpy as np
import pytest

from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.scan.box import extent_words, inside

CLOUD = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 3))


def test_it_keeps_the_points_inside_in_their_order():
    box = [-0.5, 0.5, -1.0, 0.0, 0.2, np.inf]
    expected = [
        p for p in CLOUD if -0.5 <= p[0] <= 0.5 and -1.0 <= p[1] <= 0.0 and p[2] >= 0.2
    ]
    assert 10 < len(expected) < 200
    np.testing.assert_array_equal(CLOUD[inside(CLOUD, box)], expected)


def test_a_point_on_a_side_is_inside():
    corner = np.array([[0.0, 1.0, 2.0]])
    assert inside(corner, [0, 1, 0, 1, 0, 2]).sum() == 1


@pytest.mark.parametrize(
    ("box", "told"),
    [
        ([0, 1, 0, 1], "a box is xmin,xmax"),
        ([0, 1, 0, np.nan, 0, 1], "a box is xmin,xmax"),
        ([0, 1, 1, 1, 0, 1], "ymin 1 and ymax 1"),
        ([0, 1, 0, 1, 3, 2], "zmin 3 and zmax 2"),
        ([5, 6, 0, 1, 0, 1], "no point lies in the box: the scan reaches x -"),
    ],
)
def test_other_boxes_are_refused(box, told):
    refuses(InputError, told, inside, CLOUD, box)


def test_the_extent_in_words():
    ends = np.array([[0.0, -1.0, 0.25], [0.5, 2.0, 0.25]])
    assert extent_words(ends) == "x 0 to 0.5, y -1 to 2, z 0.25 to 0.25"
