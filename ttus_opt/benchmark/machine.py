"""The machine, the packages and the memory of a measurement."""

from __future__ import annotations

import contextlib
import ctypes
import importlib.metadata
import json
import os
import platform
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from ttus_opt.core.threads import usable_cores


def peak_bytes() -> int:
    """Largest resident size since the start or the last `reset_peak` [byte]."""
    # preferred over ru_maxrss, which starts at the parent's size after a fork
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return largest * (1 if sys.platform == "darwin" else 1024)


def resident_bytes(pid: int | None = None) -> int:
    """Resident size of a process, of this one by default; 0 when it is gone [byte]."""
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:
        return 0


def available_bytes() -> int:
    """Memory available without swapping [byte]."""
    return int(psutil.virtual_memory().available)


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


def timed(work: Callable[[], object], count: int) -> list[float]:
    """Wall time of every call of so many [s]."""
    taken = []
    for _ in range(count):
        start = time.perf_counter()
        made = work()
        taken.append(time.perf_counter() - start)
        del made  # its end is not timed
    return taken


#: Packages whose version affects a measurement
PACKAGES = (
    *("ttus-opt", "numpy", "scipy", "numba", "qpsolvers", "cvxpy", "clarabel", "osqp"),
    *("scs", "piqp", "proxsuite", "qpalm", "highspy", "pypardiso", "mkl"),
    *("scikit-sparse", "pyamg"),
)


def describe() -> dict[str, str]:
    """Processor, memory, system and versions, by name."""
    facts = {
        "processor": _processor(),
        "cores": str(usable_cores()),
        "load at the start": f"{os.getloadavg()[0]:.1f}",
        "memory available": f"{available_bytes() / 2**30:.1f} GiB",
        "system": f"{platform.system()} {platform.release()}",
        "Python": platform.python_version(),
    }
    for package in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            facts[package] = importlib.metadata.version(package)
    return facts


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


#: In a run's folder: a line per stage, the residual reached, and files to keep
STAGES, RESIDUAL, KEPT = "stages.jsonl", "residual.txt", "kept"


class Progress:
    """Reports stages to the parent, and measures the memory of each.

    Attributes:
        peaks: Largest size of the process per stage [byte].
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._current = ""
        self.peaks: dict[str, int] = {}

    def __call__(self, stage: str) -> None:
        """Begin a stage, and end the previous one."""
        self.end()
        self._current = stage
        with (self._folder / STAGES).open("a", encoding="utf-8") as file:
            file.write(json.dumps({"stage": stage, "time": time.time()}) + "\n")
        reset_peak()

    def end(self) -> None:
        """Store the memory peak of the current stage."""
        if self._current:
            before = self.peaks.get(self._current, 0)
            self.peaks[self._current] = max(before, peak_bytes())
            self._current = ""

    def reached(self, residual: float) -> None:
        """Store a relative KKT residual, in case the run is ended [–]."""
        (self._folder / RESIDUAL).write_text(repr(residual), encoding="utf-8")

    def keep(self, name: str) -> Path:
        """Path for a file to be kept in the folder of the results."""
        path = self._folder / KEPT / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path
