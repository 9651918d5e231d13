"""Work beside the page: a thread a kind, the latest of each kind, errors told."""

from __future__ import annotations

import threading
from collections.abc import Callable

from ttus_opt.core.errors import TtusError


class Jobs:
    """Does what is asked for, each kind in a thread of its own.

    A newer job of a kind replaces one that has not begun; a long one of another kind
    is not waited for.

    Args:
        tell: Called with one line where a job fails.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._wanted: dict[str, Callable[[], None]] = {}
        self._working: set[str] = set()
        self._changed = threading.Condition()
        self._open = True

    def post(self, name: str, job: Callable[[], None]) -> None:
        """Do a job soon, instead of one of the same name that has not begun."""
        with self._changed:
            if not self._open:
                return
            self._wanted[name] = job
            if name in self._working:
                return
            self._working.add(name)
        threading.Thread(target=self._work, args=(name,), daemon=True).start()

    def wait(self, seconds: float) -> bool:
        """Wait until nothing is left to do; False if that takes longer."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._working, seconds)

    def close(self, seconds: float = 5.0) -> None:
        """Leave out what has not begun, and wait some time for the rest."""
        with self._changed:
            self._open = False
            self._wanted.clear()
        self.wait(seconds)

    def _work(self, name: str) -> None:
        while True:
            with self._changed:
                job = self._wanted.pop(name, None)
                if job is None:
                    self._working.remove(name)
                    self._changed.notify_all()
                    return
            try:
                job()
            except TtusError as error:
                self._tell(str(error))
            except Exception as error:
                self._tell(f"{name}: {type(error).__name__}: {error}")
