"""The deadline of a solve."""

import time

from ttus_opt.solvers.dual.options import Accuracy


def test_a_deadline_passes():
    now = time.perf_counter()
    assert not Accuracy(1e-8).late
    assert not Accuracy(1e-8, deadline=now + 60.0).late
    assert Accuracy(1e-8, deadline=now - 1.0).late
