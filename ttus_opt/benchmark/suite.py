"""The whole benchmark: what to run, in which order, saved as it comes.

Rows are appended to ``rows.jsonl`` in the output folder, a line per run; a run that is
there already is not run again, so that an interrupted benchmark goes on where it
stopped.
"""

from __future__ import annotations

import contextlib
import functools
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

from ttus_opt import optional
from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.isolation import run_isolated
from ttus_opt.benchmark.memory import available_bytes
from ttus_opt.benchmark.parts.registry import SOLVERS, parts
from ttus_opt.benchmark.row import Row, RunSpec
from ttus_opt.benchmark.settings import Settings
from ttus_opt.errors import InputError

#: Part of the memory available at the start that one run may take
MEMORY_PART = 0.8

#: Called with a run and its rows as they come
Told = Callable[[RunSpec, list[Row]], None]

#: Called several times a second with a run, its stage, and how long that has lasted [s]
Watching = Callable[[RunSpec, str, float], None]


@dataclass(frozen=True)
class Suite:
    """A benchmark to run.

    Attributes:
        cases: The scenes.
        output: Folder of the results.
        settings: What is asked of the runs.
        parts: Names of the parts.
        jobs: Runs of solvers at the same time; times are comparable with one only.
        dask: Address of a dask scheduler for them; "" for this machine.
        memory_limit: Largest size of one run's process [byte]; None for a part of
            what is available.
    """

    cases: Sequence[CaseSpec]
    output: Path
    settings: Settings = field(default_factory=Settings)
    parts: Sequence[str] = (SOLVERS,)
    jobs: int = 1
    dask: str = ""
    memory_limit: int | None = None

    @property
    def rows_file(self) -> Path:
        """Where the rows are saved."""
        return self.output / "rows.jsonl"

    @property
    def allowance(self) -> int | None:
        """Largest size of one run's process now; None for no limit [byte]."""
        if self.memory_limit is not None or self.dask:
            return self.memory_limit
        available = available_bytes()
        if available is None:
            return None
        return int(MEMORY_PART * available / max(self.jobs, 1))

    @functools.cached_property
    def plan(self) -> list[RunSpec]:
        """Every run, part by part.

        Raises:
            InputError: Something asked for is not there or out of range: told before
                anything runs.
        """
        if self.jobs < 1:
            raise InputError(f"jobs must be at least 1, got {self.jobs}")
        return [
            spec
            for name in self.parts
            for spec in parts()[name].plan(self.cases, self.settings)
        ]

    def done(self) -> dict[str, list[Row]]:
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
        self, told: Told | None = None, watching: Watching | None = None
    ) -> dict[str, list[Row]]:
        """Run what is missing.

        Args:
            told: Called with every run as it ends, earlier ones included.
            watching: Called while runs are under way, one at a time.

        Returns:
            Finished rows by part in the order of the plan, for every part there is,
            empty for those not asked for.

        Raises:
            InputError: As `plan`, or no dask scheduler answers.
            MissingPackageError: dask is asked for and not installed.
        """
        earlier = self.done()
        rows = {s.key: earlier[s.key] for s in self.plan if s.key in earlier}
        for spec in self.plan:
            if told is not None and spec.key in rows:
                told(spec, rows[spec.key])
        missing = [spec for spec in self.plan if spec.key not in rows]
        for spec, found in self._results(missing, watching):
            rows[spec.key] = found
            self.output.mkdir(parents=True, exist_ok=True)
            with self.rows_file.open("a", encoding="utf-8") as file:
                file.write(json.dumps(found) + "\n")
            if told is not None:
                told(spec, found)
        return {
            name: part.finished(
                [r for s in self.plan if s.part == name for r in rows[s.key]],
                self.settings,
                self.output,
            )
            for name, part in parts().items()
        }

    def _results(
        self, missing: Sequence[RunSpec], watching: Watching | None
    ) -> Iterator[tuple[RunSpec, list[Row]]]:
        """Rows as they come: refusals, what may run side by side, the rest."""
        refused: dict[str, Row] = {}
        for name, part in parts().items():
            refused |= part.refused([spec for spec in missing if spec.part == name])
        yield from ((s, [refused[s.key]]) for s in missing if s.key in refused)
        left = [spec for spec in missing if spec.key not in refused]
        limit = self.allowance
        if self.jobs > 1 or self.dask:
            with self._executor() as executor:
                futures = {
                    executor.submit(run_isolated, spec, self.output, limit): spec
                    for spec in left
                    if parts()[spec.part].parallel
                }
                for future in as_completed(futures):
                    yield futures[future], future.result()
            left = [spec for spec in left if not parts()[spec.part].parallel]
        for spec in left:
            watch = watching and functools.partial(watching, spec)
            yield spec, run_isolated(spec, self.output, limit, watch)

    @contextlib.contextmanager
    def _executor(self) -> Iterator[Executor]:
        """Threads that wait for processes, or a dask cluster if it answers."""
        if not self.dask:
            with ThreadPoolExecutor(self.jobs) as executor:
                yield executor
            return
        with optional.dask_client(self.dask) as client:
            yield client.get_executor()
