"""The whole benchmark: its runs in order, saved one by one.

Rows are appended to ``rows.jsonl`` in the output folder, a line per run. Runs that are
already there are skipped, so that an interrupted benchmark resumes.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.isolation import run_isolated
from ttus_opt.benchmark.machine import available_bytes
from ttus_opt.benchmark.parts.base import SOLVERS, parts
from ttus_opt.benchmark.row import Row, RunSpec, Settings
from ttus_opt.core import optional
from ttus_opt.core.errors import InputError, warn
from ttus_opt.core.saved_results import append_line, read_lines

#: Fraction of the available memory that one run may take
MEMORY_PART = 0.8

#: Called with every finished run and its rows
Reported = Callable[[RunSpec, list[Row]], None]

#: Called several times a second with a run, its stage, and the stage's duration [s]
Watching = Callable[[RunSpec, str, float], None]


@dataclass(frozen=True)
class Suite:
    """A benchmark to run.

    Attributes:
        cases: The scenes.
        output: Folder of the results.
        settings: Settings of the runs.
        parts: Names of the parts.
        jobs: Parallel runs of solvers; times are comparable with one only.
        dask: Address of a dask scheduler for them; "" for this machine.
        memory_limit: Largest size of one run's process [byte]; None for a fraction of
            the available memory.
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
        """The file of the rows."""
        return self.output / "rows.jsonl"

    @property
    def allowance(self) -> int | None:
        """Current limit of one run's process; None for no limit [byte]."""
        if self.memory_limit is not None or self.dask:
            return self.memory_limit
        return int(MEMORY_PART * available_bytes() / max(self.jobs, 1))

    @functools.cached_property
    def plan(self) -> list[RunSpec]:
        """All runs, part by part.

        Raises:
            InputError: An unknown name or a number out of range, before anything runs.
        """
        if self.jobs < 1:
            raise InputError(f"jobs must be at least 1, got {self.jobs}")
        return [
            spec
            for name in self.parts
            for spec in parts()[name].plan(self.cases, self.settings)
        ]

    def done(self) -> dict[str, list[Row]]:
        """Rows of an earlier run in the same folder, by key.

        Without those for which a package was missing, which may be there by now.
        """
        finished = {}
        for rows in read_lines(self.rows_file):
            with contextlib.suppress(LookupError, TypeError):  # of another version
                if rows[0]["status"] != "not installed":
                    finished[rows[0]["key"]] = rows
        return finished

    def run(
        self, reported: Reported | None = None, watching: Watching | None = None
    ) -> dict[str, list[Row]]:
        """Run what is missing.

        Args:
            reported: Called with every finished run, earlier ones included.
            watching: Called during sequential runs.

        Returns:
            Finished rows by part in the order of the plan; empty for other parts.

        Raises:
            InputError: As `plan`, or no dask scheduler answers.
            MissingPackageError: dask is requested and not installed.
        """
        earlier = self.done()
        rows = {s.key: earlier[s.key] for s in self.plan if s.key in earlier}
        if rows:
            warn(
                f"{len(rows)} of {len(self.plan)} runs are those of an earlier call, "
                f"from {self.rows_file}: remove it to measure them anew"
            )
        for spec in self.plan:
            if reported is not None and spec.key in rows:
                reported(spec, rows[spec.key])
        missing = [spec for spec in self.plan if spec.key not in rows]
        for spec, finished in self._results(missing, watching):
            rows[spec.key] = finished
            append_line(self.rows_file, finished)
            if reported is not None:
                reported(spec, finished)
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
        """Rows as they finish: refusals, parallel runs, then the rest."""
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
        """Threads that wait for processes, or a dask cluster."""
        if not self.dask:
            with ThreadPoolExecutor(self.jobs) as executor:
                yield executor
            return
        with optional.dask_client(self.dask) as client:
            yield client.get_executor()
