"""The folder of a session's results, written step by step."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ttus_opt.core import io
from ttus_opt.core.errors import FileError, TtusError
from ttus_opt.core.saved_results import plain, read_json, write_json

#: Complete steps and their figures
SUMMARY = "session.json"

STEPS = (
    "surface",
    "registration",
    "clock",
    "load",
    "recordings",
    "fit",
    "evaluation",
    "report",
)

#: Files that a session writes, and may therefore replace
OWN = (
    "surface.nc",
    "field.nc",
    "report.md",
    "report.html",
    SUMMARY,
    "recordings/*.csv",
    "figures/*.png",
)


class Results:
    """A folder that is filled step by step.

    Args:
        folder: Made when missing; results of an earlier session in it are removed when
            the first step begins to write.
        progress: Called with the name of every step that begins.
    """

    def __init__(
        self, folder: str | os.PathLike[str], progress: Callable[[str], None]
    ) -> None:
        self.folder = Path(folder)
        self._progress = progress
        self._told: dict[str, Any] = {"complete": [], "files": []}
        self._cleared = False

    def check(self, inputs: Sequence[Path]) -> None:
        """Refuse, before any work, a folder that cannot be written to.

        Raises:
            FileError: It is not writable, holds the recording, or other results.
        """
        for file in inputs:
            place = file.resolve().parent
            if place == self.folder.resolve():
                raise FileError(
                    f"{self.folder} holds the recording: choose another folder for "
                    "the results"
                )
        io.check_output(self.folder / SUMMARY)
        # a recording's description may have the summary's name
        if self._existing() and "complete" not in _read(self.folder):
            raise FileError(
                f"{self.folder} holds unrelated files, for instance "
                f"{self._existing()[0].name}: choose another folder"
            )

    @contextlib.contextmanager
    def step(self, name: str) -> Iterator[None]:
        """One of `STEPS`; recorded as complete when it ends without an error.

        Raises:
            TtusError: The step's error, with its name before the message and the
                complete steps after it.
        """
        self._progress(name)
        try:
            yield
        except TtusError as error:
            done = ", ".join(self._told["complete"])
            after = f" (complete in {self.folder}: {done})" if done else ""
            error.args = (f"{name}: {error}{after}",)
            raise
        self._told["complete"].append(name)
        self._clear()
        write_json(self.folder / SUMMARY, self._told, indent=2)

    def tell(self, name: str, facts: Mapping[str, Any]) -> None:
        """Keep a step's figures for `SUMMARY`."""
        self._told[name] = plain(facts)

    def path(self, name: str) -> Path:
        """Where a file goes; earlier results are removed first."""
        self._clear()
        self._told["files"].append(name)
        return self.folder / name

    @property
    def figures(self) -> dict[str, Any]:
        """All figures so far."""
        return dict(self._told)

    def _existing(self) -> list[Path]:
        return [file for name in OWN for file in sorted(self.folder.glob(name))]

    def _clear(self) -> None:
        """Remove what an earlier session wrote, its summary last.

        Raises:
            FileError: A file cannot be removed.
        """
        if self._cleared:
            return
        self._cleared = True
        written = _read(self.folder).get("files", [])
        earlier = [
            f for f in self._existing() if str(f.relative_to(self.folder)) in written
        ]
        for file in [*earlier, self.folder / SUMMARY]:
            try:
                file.unlink(missing_ok=True)
            except OSError as error:
                raise FileError(
                    f"cannot replace {file}: {error.strerror}: name another folder"
                ) from error


def complete_steps(folder: str | os.PathLike[str]) -> list[str]:
    """Complete steps in a folder; none without a session's summary."""
    return [step for step in STEPS if step in _read(folder).get("complete", [])]


def _read(folder: str | os.PathLike[str]) -> dict[str, list[str]]:
    """The lists of a summary; none without such a file."""
    summary = read_json(Path(folder) / SUMMARY)
    lists = summary.items() if isinstance(summary, dict) else ()
    return {name: value for name, value in lists if isinstance(value, list)}
