"""Dense algebra by one thread, where matrices are small.

A BLAS wakes its threads even for a matrix of a hundred rows, and they keep every
processor busy while they wait for the next one: choosing weights then takes several
times the processor time, and longer.
"""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any


@functools.cache
def _libraries() -> Any:
    """The BLAS libraries of numpy and scipy, which are searched for once."""
    import scipy.linalg  # noqa: F401  # loads its own
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


@dataclass
class _Users:
    """Who wants one thread: the number is that of the process, not of a thread."""

    count: int = 0
    limit: Any = None
    lock: threading.Lock = field(default_factory=threading.Lock)


_users = _Users()


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let one thread do numpy's and scipy's dense algebra; also as a decorator.

    The number of threads before is restored when the last user leaves.
    """
    with _users.lock:
        if not _users.count:
            _users.limit = _libraries().limit(limits=1)
        _users.count += 1
    try:
        yield
    finally:
        with _users.lock:
            _users.count -= 1
            if not _users.count:
                _users.limit.restore_original_limits()
