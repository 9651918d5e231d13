"""Points of a path in several processes."""

import warnings

import pytest

from ttus_opt.core.errors import TtusWarning
from ttus_opt.fitting.path.solution_path import several_at_a_time


def warned(declared):
    warnings.warn("of one place", TtusWarning, stacklevel=1)
    warnings.warn(f"only of {declared}", TtusWarning, stacklevel=1)
    return f"fit of {declared}"


def test_a_warning_of_several_points_is_told_once():
    points = [(0,), (1,), (2,)]
    found = several_at_a_time(warned, points, lambda i: i[0] % 2, 2, "")
    with pytest.warns(TtusWarning) as told:
        by_point = {index: fit for index, fit, _ in found}
    assert by_point == {(i,): f"fit of {i % 2}" for i in range(3)}
    messages = sorted(str(one.message) for one in told)
    assert messages == ["of one place", "only of 0", "only of 1"]
