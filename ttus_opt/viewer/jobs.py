"""Work beside the page: one thread, the latest of each kind, errors told."""

from __future__ import annotations

import threading
from collections.abc import Callable

from ttus_opt.core.errors import TtusError


class Jobs:
    """A thread that does what is asked for; a newer job of a name replaces an older.

    Args:
        tell: Called with one line where a job fails.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._wanted: dict[str, Callable[[], None]] = {}
        self._changed = threading.Condition()
        self._open, self._busy = True, False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def post(self, name: str, job: Callable[[], None]) -> None:
        """Do a job soon, instead of one of the same name that has not begun."""
        with self._changed:
            self._wanted[name] = job
            self._changed.notify_all()

    def wait(self, seconds: float) -> bool:
        """Wait until nothing is left to do; False if that takes longer."""
        with self._changed:
            return self._changed.wait_for(
                lambda: not (self._wanted or self._busy), seconds
            )

    def close(self) -> None:
        """Leave out what has not begun and end the thread."""
        with self._changed:
            self._open = False
            self._wanted.clear()
            self._changed.notify_all()
        self._thread.join(timeout=5.0)

    def _work(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._wanted or not self._open)
                if not self._open:
                    return
                name = next(iter(self._wanted))
                job, self._busy = self._wanted.pop(name), True
            try:
                job()
            except TtusError as error:
                self._tell(str(error))
            except Exception as error:
                self._tell(f"{name}: {type(error).__name__}: {error}")
