"""Work side by side, also where a system does not say which cores there are."""

from __future__ import annotations

import os
import threading

import pytest

from ttus_opt.threads import side_by_side, usable_cores


def test_results_stand_in_the_order_of_the_things() -> None:
    assert side_by_side(lambda a, b: a - b, range(9), range(0, 90, 10)) == [
        a - 10 * a for a in range(9)
    ]
    assert side_by_side(str, []) == []


def test_an_error_reaches_the_caller() -> None:
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda a: 1 / a, [1, 0])


@pytest.mark.parametrize(("told", "cores"), [(3, 3), (None, 1)])
def test_systems_without_affinity(
    told: int | None, cores: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: told)
    assert usable_cores() == cores


def test_as_many_at_a_time_as_there_are_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ttus_opt.threads.usable_cores", lambda: 2)
    both = threading.Barrier(2, timeout=20.0)
    side_by_side(lambda _: both.wait(), range(2))
