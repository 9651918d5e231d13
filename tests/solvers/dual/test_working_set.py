"""Working sets on a grid of one slice and few spokes, block by block, by hand."""

import itertools

import numpy as np
import pytest

from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.working_set import WorkingSet, one_bound_each

INF = np.inf


def limits(lower, upper, least=0.0, scale=1.0):
    """One spoke, inside out."""
    n = len(lower)
    return SpokeLimits(
        (n, 1, 1), scale * np.array(lower), scale * np.array(upper),
        np.zeros(n, dtype=bool), np.append(np.full(n - 1, scale * least), -INF), {},
    )  # fmt: skip


def active(bounds, links):
    return WorkingSet(np.array(bounds, dtype=np.int8), np.array(links, dtype=bool))


def test_counts_and_differences():
    one, other = active([0, -1, 1], [1, 0, 0]), active([1, -1, 0], [1, 1, 0])
    assert (one.count, other.count) == (3, 4)
    assert one.differs(other) == other.differs(one) == 3
    assert WorkingSet.empty(3).count == 0 and one.differs(one) == 0


def test_limits_that_are_gone_are_left_out():
    there = active([-1, 1, 1], [1, 1, 1]).existing(limits([0, 0, 0], [INF, 5, INF]))
    assert there.bounds.tolist() == [-1, 1, 0]
    assert there.links.tolist() == [True, True, False]


@pytest.mark.parametrize(
    ("bounds", "kept", "links"),
    [
        # p_0 >= p_1 >= p_2, lower bounds 0, upper bounds 4; all linked
        ([-1, 0, 0], [-1, 0, 0], [1, 1]),  # one bound stays
        ([-1, 0, -1], [-1, 0, 0], [1, 1]),  # of two that agree the first does
        ([1, 0, -1], [1, 0, -1], [1, 0]),  # between 4 and 0 a link is slack: cut
    ],
)
def test_a_block_has_one_bound(bounds, kept, links):
    spoke = limits([0.0, 0.0, 0.0], [4.0, 4.0, 4.0])
    found = one_bound_each(spoke, active(bounds, [1, 1, 0]))
    assert found.bounds.tolist() == kept
    assert found.links[:2].astype(int).tolist() == links


def test_never_two_bounds_in_a_block_nor_more_limits_than_before():
    """Every working set of a spoke of four with a least slope, in any unit."""
    values = [1.0, 0.5, 0.0, -1.0], [9.0, 6.0, 4.0, 2.0]
    spoke, larger = limits(*values, least=1.0), limits(*values, least=1.0, scale=1e4)
    for bounds in itertools.product((-1, 0, 1), repeat=4):
        for links in itertools.product((0, 1), repeat=3):
            before = active(list(bounds), [*links, 0])
            after = one_bound_each(spoke, before)
            blocks = np.concatenate([[0], np.cumsum(~after.links[:3])])
            # one bound where there were any
            some = np.bincount(blocks, before.bounds != 0) > 0
            np.testing.assert_array_equal(np.bincount(blocks, after.bounds != 0), some)
            assert not after.differs(one_bound_each(larger, before))
            assert not ((after.bounds != 0) & (before.bounds == 0)).any()
            assert not (after.links & ~before.links).any()
            assert (after.bounds * before.bounds >= 0).all()


def test_a_given_value_goes_before_a_bound_that_agrees_with_it():
    """p_2 = 0 is given, p_0 is held at its lower bound 0, and all are linked."""
    spoke = limits([0.0, 0.0, 0.0], [4.0, 4.0, 0.0])
    spoke.given[2] = True
    found = one_bound_each(spoke, active([-1, 0, 0], [1, 1, 0]))
    assert not found.bounds.any()
    assert found.links.tolist() == [True, True, False]
    # at another value than the given one the block is cut
    apart = one_bound_each(spoke, active([1, 0, 0], [1, 1, 0]))
    assert apart.bounds.tolist() == [1, 0, 0]
    assert apart.links.tolist() == [True, False, False]
