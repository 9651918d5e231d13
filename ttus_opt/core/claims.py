"""Claims on files that several processes want to create: one does, the others wait.

A claim is an operating-system lock on a file beside the one to be created. It ends with
the process that holds it, even if that crashes. Without such locks (Windows) nobody
waits, and the same work may be done twice.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


class Claims:
    """The claims held by one object of this process."""

    def __init__(self) -> None:
        self._held: dict[Path, int] = {}

    def take(self, path: Path) -> None:
        """Claim the creation of a file, once no other process claims it any more.

        Taking a claim that is already held does nothing.
        """
        if fcntl is None or path in self._held:
            return
        with contextlib.suppress(OSError):  # no lock possible: create it without one
            lock = os.open(_lock(path), os.O_CREAT | os.O_RDWR, 0o600)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX)
            except BaseException:
                os.close(lock)
                raise
            self._held[path] = lock

    def release(self) -> None:
        """Give up all claims: the files exist now, or will not be created."""
        while self._held:
            path, lock = self._held.popitem()
            _lock(path).unlink(missing_ok=True)
            os.close(lock)


def _lock(path: Path) -> Path:
    return path.with_name(f".{path.name}.lock")
