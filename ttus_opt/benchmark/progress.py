"""Reports of a run's process to its parent: stages, memory, and files."""

from __future__ import annotations

import json
import time
from pathlib import Path

from ttus_opt.benchmark import machine

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
        machine.reset_peak()

    def end(self) -> None:
        """Store the memory peak of the current stage."""
        if self._current:
            before = self.peaks.get(self._current, 0)
            self.peaks[self._current] = max(before, machine.peak_bytes())
            self._current = ""

    def reached(self, residual: float) -> None:
        """Store a relative KKT residual, in case the run is ended [–]."""
        (self._folder / RESIDUAL).write_text(repr(residual), encoding="utf-8")

    def keep(self, name: str) -> Path:
        """Path for a file to be kept in the folder of the results."""
        path = self._folder / KEPT / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path
