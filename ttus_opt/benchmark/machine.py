"""The machine and the packages of a measurement."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform
from pathlib import Path

from ttus_opt.benchmark.memory import available_bytes
from ttus_opt.core.threads import usable_cores

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
