"""Current and peak memory of a process."""

from __future__ import annotations

import contextlib
import ctypes
import resource
import sys
from pathlib import Path


def peak_bytes() -> int:
    """Largest resident size since the start or the last `reset_peak` [byte]."""
    # preferred over ru_maxrss, which starts at the parent's size after a fork
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    unit = 1 if sys.platform == "darwin" else 1024
    return _from_proc("self/status", "VmHWM") or largest * unit


def current_bytes() -> int:
    """Resident size now; the peak if the system does not report it [byte]."""
    return _from_proc("self/status", "VmRSS") or peak_bytes()


def resident_bytes(pid: int) -> int:
    """Resident size of a process; 0 when it is gone or not reported [byte]."""
    return _from_proc(f"{pid}/status", "VmRSS") or 0


def available_bytes() -> int | None:
    """Memory available without swapping; None if it is not reported [byte]."""
    return _from_proc("meminfo", "MemAvailable")


def reset_peak() -> None:
    """Reset the peak, if the system can do that."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def trim() -> None:
    """Return freed memory to the system, if the C library can do that.

    Later allocations then show in the resident size, instead of reusing freed pages.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def end_this_first() -> None:
    """Ask the system to end this process before others when memory runs out."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


def _from_proc(file: str, key: str) -> int | None:
    """A line ``key: number kB`` of a file in ``/proc`` [byte]; None without one."""
    with contextlib.suppress(OSError):
        for line in Path("/proc", file).read_text(encoding="ascii").splitlines():
            name, _, rest = line.partition(":")
            if name == key:
                return int(rest.split()[0]) * 1024
    return None
