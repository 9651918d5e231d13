"""The process of one run: what it measures, and what it says of a failure."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from ttus_opt.benchmark import machine, worker
from ttus_opt.benchmark.isolation import ANSWER, QUESTION
from ttus_opt.benchmark.machine import STAGES
from ttus_opt.benchmark.parts.base import Column, Part
from ttus_opt.benchmark.row import MEASURED, Row, RunSpec
from ttus_opt.core.errors import InputError, MissingPackageError

SPEC = RunSpec("mine", options={"voxel": 3}, time_limit=5.0)
MEBIBYTE = 2**20


class Mine(Part):
    """Fails as it is told to, or measures two rows in two stages."""

    name = "mine"
    title = legend = "Mine"
    columns: Sequence[Column] = (Column("Number", "number"),)

    def __init__(self, failure=None):
        self._failure = failure

    def measure(self, spec, begin):
        begin("small")
        if self._failure is not None:
            raise self._failure
        begin("large")
        np.ones(64 * MEBIBYTE // 8)
        return [{"number": 1, "detail": "own"}, {"number": spec.options["voxel"]}]


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """Rows of a run of such a part, in this process."""
    monkeypatch.setattr(machine, "end_this_first", lambda: None)

    def run(failure=None):
        monkeypatch.setattr(worker, "parts", lambda: {"mine": Mine(failure)})
        (tmp_path / QUESTION).write_text(json.dumps(asdict(SPEC)))
        worker.main(tmp_path)
        rows: list[Row] = json.loads((tmp_path / ANSWER).read_text())
        return rows

    return run


def test_every_row_has_what_is_common_and_its_own(asked, tmp_path):
    one, three = asked()
    assert (one["number"], three["number"]) == (1, 3)
    assert (one["detail"], three["detail"]) == ("own", "")
    for row in (one, three):
        assert (row["key"], row["case"], row["status"]) == (SPEC.key, "–", MEASURED)
    stages = (tmp_path / STAGES).read_text().splitlines()
    assert [json.loads(line)["stage"] for line in stages] == ["small", "large"]


def test_memory_is_that_of_the_largest_stage(asked):
    """Also of the last one, which no other ends."""
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("this system does not tell a process's peak")
    row = asked()[0]
    told = row["memory_by_stage"]
    assert set(told) == {"small", "large"}
    assert row["peak_memory_bytes"] == max(told.values())
    assert told["large"] > told["small"] + 32 * MEBIBYTE


@pytest.mark.parametrize(
    ("failure", "status", "detail"),
    [
        (MissingPackageError("install osqp"), "not installed", "install osqp"),
        (MemoryError("in a matrix"), "memory limit", "out of memory in a matrix"),
        (MemoryError(), "memory limit", "out of memory"),
        (InputError("not on this grid"), "refused", "not on this grid"),
    ],
)
def test_a_failure_is_one_row_without_values(asked, failure, status, detail):
    (row,) = asked(failure)
    assert (row["status"], row["detail"]) == (status, detail)
    assert "number" not in row and row["voxel"] == 3
    assert row["peak_memory_bytes"] > MEBIBYTE
    assert set(row["memory_by_stage"]) == {"small"}


def test_a_mistake_in_a_part_ends_the_process(asked):
    """Its parent makes a row of that."""
    with pytest.raises(ZeroDivisionError):
        asked(ZeroDivisionError())
