"""The machine's description and memory."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from tests.kit import python
from ttus_opt.benchmark import machine
from ttus_opt.benchmark.machine import KEPT, RESIDUAL, STAGES, Progress, describe


def test_machine_names_what_decides_a_figure():
    facts = describe()
    assert int(facts["cores"]) >= 1
    assert facts["numpy"] == np.__version__


MEMORY_PROGRAM = """
import numpy as np
from ttus_opt.benchmark import machine
machine.reset_peak()
before = machine.peak_bytes()
block = np.ones(16 * 2**20)
during = machine.peak_bytes()
del block
machine.reset_peak()
print(before, during, machine.peak_bytes())
"""


@pytest.mark.slow
def test_peak_memory_sees_an_allocation_and_forgets_it():
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("this system does not tell a process's peak")
    # in a process of its own: this one has freed pages that an array would take again
    told = python("-c", MEMORY_PROGRAM)
    before, during, after = map(int, told.stdout.split())
    assert during - before >= 0.9 * 128 * 2**20
    assert after < during - 64 * 2**20


def test_sizes_grow_with_what_is_held():
    before = machine.resident_bytes()
    held = np.ones(2**24)
    assert machine.resident_bytes() - before > 0.9 * held.nbytes
    assert abs(machine.resident_bytes(os.getpid()) - machine.resident_bytes()) < 2**24
    assert machine.resident_bytes(2**22 + 1) == 0  # no process has such a number


def test_stages_are_told_as_they_begin_and_measured_as_they_end(tmp_path):
    progress = Progress(tmp_path)
    for stage in ("scene", "first", "scene"):
        progress(stage)
        np.ones(10)
    assert set(progress.peaks) == {"scene", "first"}  # the last has not ended
    progress.end()
    progress.end()  # nothing runs any more
    lines = (tmp_path / STAGES).read_text().splitlines()
    told = [json.loads(line) for line in lines]
    assert [line["stage"] for line in told] == ["scene", "first", "scene"]
    assert told[0]["time"] <= told[1]["time"] <= told[2]["time"]
    assert all(peak > 2**20 for peak in progress.peaks.values())


def test_the_last_residual_stands(tmp_path):
    progress = Progress(tmp_path)
    for residual in (1e-2, 1.0 / 3.0):
        progress.reached(residual)
    assert float((tmp_path / RESIDUAL).read_text()) == 1.0 / 3.0


def test_what_is_kept_may_lie_in_a_folder_of_its_own(tmp_path):
    path = Progress(tmp_path).keep("profiles/eq10.txt")
    path.write_text("a profile")
    assert (tmp_path / KEPT / "profiles" / "eq10.txt").read_text() == "a profile"
