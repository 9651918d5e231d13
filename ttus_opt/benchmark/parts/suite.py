"""All runs of the parts asked for, one process each, saved as they come.

Rows are appended to ``parts.jsonl`` in the output folder, a run's at once; a run that
is there already is not run again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.isolation import ANSWER, PREPARATION, isolated, late
from ttus_opt.benchmark.parts.base import PREPARING, Figures, PartSpec
from ttus_opt.benchmark.parts.registry import parts

#: The process of a part's run
WORKER = "ttus_opt.benchmark.parts.worker"


@dataclass(frozen=True)
class PartSuite:
    """Parts to measure, one run at a time.

    Attributes:
        names: Of the parts, from `parts.registry.chosen`.
        cases: The scenes.
        output: Folder of the results.
        time_limit: Most seconds of one stage [s].
        memory_limit: Largest size of one run's process [byte]; None for no limit.
    """

    names: Sequence[str]
    cases: Sequence[CaseSpec]
    output: Path
    time_limit: float = 600.0
    memory_limit: int | None = None

    @property
    def rows_file(self) -> Path:
        """Where the rows are saved."""
        return self.output / "parts.jsonl"

    def plan(self) -> list[PartSpec]:
        """Every run, part by part."""
        return [
            spec
            for name in self.names
            if name in parts()
            for spec in parts()[name].plan(self.cases, self.time_limit)
        ]

    def done(self) -> dict[str, list[Figures]]:
        """Rows of an earlier run in the same folder, by key."""
        if not self.rows_file.exists():
            return {}
        found = {}
        for line in self.rows_file.read_text("utf-8").splitlines():
            try:
                rows = json.loads(line)
                found[rows[0]["key"]] = rows
            except (json.JSONDecodeError, LookupError, TypeError):
                continue  # cut off by the interruption, or of another version
        return found

    def run(
        self, told: Callable[[PartSpec, list[Figures]], None] | None = None
    ) -> dict[str, list[Figures]]:
        """Run what is missing.

        Args:
            told: Called with every run and its rows, earlier ones included.

        Returns:
            Rows by part, for every part there is, empty for those not asked for.
        """
        earlier = self.done()
        result: dict[str, list[Figures]] = {name: [] for name in parts()}
        for spec in self.plan():
            rows = earlier.get(spec.key)
            if rows is None:
                rows = run_part(spec, self.memory_limit)
                self.output.mkdir(parents=True, exist_ok=True)
                with self.rows_file.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(rows) + "\n")
            result[spec.part] += rows
            if told is not None:
                told(spec, rows)
        return result


def run_part(spec: PartSpec, memory_limit: int | None = None) -> list[Figures]:
    """Run in a process of its own and wait for it.

    Args:
        spec: What to run.
        memory_limit: Largest resident size it may reach; None for no limit [byte].

    Returns:
        Its rows; one without figures when it failed.
    """

    def allowed(stage: str) -> tuple[float, str]:
        if stage in PREPARING:
            return max(PREPARATION, late(spec.time_limit)), "assembly took too long"
        return late(spec.time_limit), "time limit"

    with isolated(WORKER, spec.as_dict(), allowed, memory_limit) as outcome:
        if not outcome.failure:
            rows: list[Figures] = json.loads((outcome.folder / ANSWER).read_text())
            return rows
        return [
            {
                "key": spec.key,
                "case": spec.case_name,
                "status": outcome.failure,
                "detail": outcome.detail,
                "peak_memory_bytes": outcome.peak or None,
                **spec.options,
            }
        ]
