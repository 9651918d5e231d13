"""Pictures drawn by a process of its own, while this one draws others."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple


class Picture(NamedTuple):
    """A picture to be made.

    Attributes:
        path: Where it goes.
        draw: Gives the figure; of a module, so that another process finds it.
        arguments: Of ``draw``.
    """

    path: Path
    draw: Callable[..., Any]
    arguments: tuple[Any, ...]

    def save(self) -> None:
        """Draw and write it.

        Raises:
            FileError: The folder cannot be written to.
        """
        from ttus_opt.report.plots.canvas import save_picture

        save_picture(self.draw(*self.arguments), self.path)


class DrawingBeside:
    """Another process that loads what draws, waits for pictures, and draws them.

    On one core there is none, and this process draws all.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> DrawingBeside:
        if cores() > 1:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()

    def save(self, here: Iterable[Picture], there: Iterable[Picture]) -> None:
        """Draw and write pictures in this process and in the other.

        What the other cannot draw is drawn here, and tells why.

        Args:
            here: Pictures for this process.
            there: For the other.

        Raises:
            FileError: The folder cannot be written to.
        """
        there = list(there)
        process = self._process
        if process is not None and process.stdin is not None:
            try:
                pickle.dump(there, process.stdin)
                process.stdin.close()
            except BrokenPipeError:
                process.kill()
        for picture in here:
            picture.save()
        if process is None or process.wait() != 0:
            for picture in there:
                picture.save()


def cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


if __name__ == "__main__":
    import ttus_opt.report.plots  # noqa: F401  while the other has other work

    for picture in pickle.load(sys.stdin.buffer):
        picture.save()
