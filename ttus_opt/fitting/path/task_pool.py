"""Independent tasks side by side: in processes here, or on a dask cluster."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from ttus_opt.core import optional
from ttus_opt.core.child_process import safe_path


@contextlib.contextmanager
def task_pool(jobs: int, address: str) -> Iterator[Any]:
    """Run joblib's tasks; results come as they are ready, in any order.

    Args:
        jobs: Processes on this machine.
        address: Address of a dask scheduler, host:port, to use instead; "" for none.

    Raises:
        MissingPackageError: joblib or dask is not installed.
        InputError: No scheduler answers.
    """
    joblib = optional.load("joblib", "parallel")
    if not address:
        with safe_path():
            # arrays are copied: compiled functions take no read-only ones
            yield joblib.Parallel(
                n_jobs=jobs, return_as="generator_unordered", max_nbytes=None
            )
        return
    with optional.dask_client(address), joblib.parallel_config("dask"):
        yield joblib.Parallel(n_jobs=-1, return_as="generator_unordered")
