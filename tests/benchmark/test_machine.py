"""The machine's description and memory."""

import os
from pathlib import Path

import numpy as np
import pytest

from tests.kit import python
from ttus_opt.benchmark import machine
from ttus_opt.benchmark.machine import describe


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
    before = machine.current_bytes()
    held = np.ones(2**24)
    assert machine.current_bytes() - before > 0.9 * held.nbytes
    assert abs(machine.resident_bytes(os.getpid()) - machine.current_bytes()) < 2**24
    assert machine.resident_bytes(2**22 + 1) == 0  # no process has such a number
