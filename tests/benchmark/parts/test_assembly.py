"""Times and memory of stages, on stages whose cost is known."""

from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import numpy as np

from tests.benchmark.parts.quick import TINY
from ttus_opt.benchmark import machine
from ttus_opt.benchmark.parts.assembly import BOUNDARY, AssemblyPart, _measured, _timed
from ttus_opt.benchmark.parts.base import SHELL_POINTS
from ttus_opt.contact.rows import Sampling


def test_memory_is_that_of_the_first_call_and_seconds_the_median(monkeypatch):
    clock = iter([0.0, 9.0, 10.0, 12.0, 20.0, 21.0])  # 9, 2 and 1 s
    own = SimpleNamespace(perf_counter=clock.__next__)  # of no other thread
    monkeypatch.setattr(machine, "time", own)
    calls = []

    def make():
        calls.append(1)
        return np.ones(2**23) if len(calls) == 1 else None  # 64 MiB, touched

    told = _timed(make, 3)
    assert len(calls) == 3
    assert told["seconds"] == 2.0
    assert told["peak_memory_bytes"] >= told["added_memory_bytes"] > 48 * 2**20


def test_stages_are_l_and_b_and_rows_in_every_sampling():
    begun: list[str] = []
    rows = _measured(replace(TINY, n_points=100), 1, begun.append)
    assert [row["stage"] for row in rows] == ["L, b"] + ["N, W"] * (len(rows) - 1)
    assert [row["sampling"] for row in rows[1:]] == list(get_args(Sampling))
    assert begun == ["scene", "L, b", *(f"N, W {s}" for s in get_args(Sampling))]
    assert {row["voxels"] for row in rows} == {9 * 20 * 9}
    assert {row["points"] for row in rows} == {100}


def test_boundary_values_that_are_fitted_are_given_instead():
    part = AssemblyPart()
    asked = part.prepared(replace(TINY, inner="fit"))
    assert (asked.inner, asked.n_points) == (BOUNDARY, SHELL_POINTS)
    assert part.prepared(replace(TINY, inner=2.5)).inner == 2.5
