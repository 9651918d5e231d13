"""Claims on files that several processes would make: one makes each, the others wait.

A claim is a lock of the operating system's on a file beside the one to be made. It
ends with the process that holds it, however that ends. Where there are no such locks
(Windows) nobody waits, and the same work may be done twice.
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
    """The claims that an object of this process holds."""

    def __init__(self) -> None:
        self._held: dict[Path, int] = {}

    def take(self, path: Path) -> None:
        """Claim a file, when nobody else does any more; for the second time, nothing.

        Args:
            path: What is to be made.
        """
        if fcntl is None or path in self._held:
            return
        with contextlib.suppress(OSError):  # no place for locks: each makes its own
            lock = os.open(_lock(path), os.O_CREAT | os.O_RDWR, 0o600)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX)
            except BaseException:
                os.close(lock)
                raise
            self._held[path] = lock

    def release(self) -> None:
        """Give back all claims: the files are made, or will not be."""
        while self._held:
            path, lock = self._held.popitem()
            _lock(path).unlink(missing_ok=True)
            os.close(lock)


def _lock(path: Path) -> Path:
    return path.with_name(f".{path.name}.lock")
