import pytest
from hypothesis import given
from hypothesis import strategies as st

from ttus_opt.live.numbering import Once, later


@given(st.lists(st.integers(1, 60), max_size=80), st.integers(1, 20))
def test_a_number_counts_once_and_not_when_it_is_too_late(numbers, window):
    once, come = Once(window), []
    for number in numbers:
        fresh = number not in come and number > max(come, default=0) - window
        assert once.add(number) is fresh
        come += [number] if fresh else []
        assert once.newest == max(come)


@pytest.mark.parametrize("step", [-7, 0, 1, 7])
def test_later_is_the_short_way_round(step):
    for before in range(16):
        assert later((before + step) % 16, before, 16) == step
