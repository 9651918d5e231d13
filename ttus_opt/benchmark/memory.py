"""How much memory this process holds, and held at most since it was last asked."""

from __future__ import annotations

import contextlib
import ctypes
import resource
import sys
from pathlib import Path

_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")


def peak_bytes() -> int:
    """Largest resident size since the start or the last `reset_peak` [byte]."""
    # the kernel's own mark: ru_maxrss starts at the parent's size after a fork
    marked = _from_status("VmHWM")
    if marked is not None:
        return marked
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return largest if sys.platform == "darwin" else largest * 1024


def current_bytes() -> int:
    """Resident size now; the peak where the system does not tell [byte]."""
    now = _from_status("VmRSS")
    return peak_bytes() if now is None else now


def reset_peak() -> None:
    """Let the next `peak_bytes` begin here, where the system can do that."""
    with contextlib.suppress(OSError):
        _CLEAR.write_text("5")


def trim() -> None:
    """Give freed memory back to the system, where the C library can do that.

    What is allocated next then shows in the resident size, instead of taking pages
    that an earlier computation left.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def resident_bytes(pid: int) -> int:
    """Resident size of another process; 0 when it is gone or the system is silent."""
    try:
        text = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    except OSError:
        return 0
    return _read(text, "VmRSS") or 0


def available_bytes() -> int | None:
    """Memory that could be had without swapping; None where it is not told [byte]."""
    try:
        text = Path("/proc/meminfo").read_text(encoding="ascii")
    except OSError:
        return None
    return _read(text, "MemAvailable")


def end_this_first() -> None:
    """Ask the system to end this process first when memory runs out."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


def _from_status(key: str) -> int | None:
    try:
        return _read(_STATUS.read_text(encoding="ascii"), key)
    except OSError:
        return None


def _read(text: str, key: str) -> int | None:
    """A line ``key: number kB`` in bytes."""
    for line in text.splitlines():
        name, _, rest = line.partition(":")
        if name == key:
            return int(rest.split()[0]) * 1024
    return None
