"""What a process is doing now, told to its parent, and how large each stage made it."""

from __future__ import annotations

import json
import time
from pathlib import Path

from ttus_opt.benchmark import memory

#: File in a run's folder with one line per stage
STAGES = "stages.jsonl"


class Stages:
    """Tells the parent what begins, and measures the memory of what ended.

    Attributes:
        peaks: Largest size of the process per stage [byte].
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._current = ""
        self.peaks: dict[str, int] = {}

    def __call__(self, stage: str) -> None:
        """A stage begins; the one before is done."""
        self.end()
        self._current = stage
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"stage": stage, "time": time.time()}) + "\n")
        memory.reset_peak()

    def end(self) -> None:
        """Note the peak of the stage that is running."""
        if self._current:
            before = self.peaks.get(self._current, 0)
            self.peaks[self._current] = max(before, memory.peak_bytes())
            self._current = ""
