"""Memory: the peak of a process sees an allocation, and can be begun anew."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ttus_opt.benchmark import memory

MEMORY_PROGRAM = """
import numpy as np
from ttus_opt.benchmark import memory
memory.reset_peak()
before = memory.peak_bytes()
block = np.ones(16 * 2**20)
during = memory.peak_bytes()
del block
memory.reset_peak()
print(before, during, memory.peak_bytes())
"""


@pytest.mark.slow
def test_peak_memory_sees_an_allocation_and_forgets_it():
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("this system does not tell a process's peak")
    # in a process of its own: this one has freed pages that an array would take again
    told = subprocess.run(
        [sys.executable, "-c", MEMORY_PROGRAM],
        capture_output=True,
        text=True,
        check=True,
    )
    before, during, after = map(int, told.stdout.split())
    assert during - before >= 0.9 * 128 * 2**20
    assert after < during - 64 * 2**20


def test_sizes_grow_with_what_is_held():
    before = memory.current_bytes()
    held = np.ones(2**24)
    assert memory.current_bytes() - before > 0.9 * held.nbytes
    assert abs(memory.resident_bytes(os.getpid()) - memory.current_bytes()) < 2**24
    assert memory.resident_bytes(2**22 + 1) == 0  # no process has such a number
