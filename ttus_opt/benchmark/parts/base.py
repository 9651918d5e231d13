"""The parts of the benchmark, discovered in this folder, and their base.

A new part is a file in this folder with a ``PART``.
"""

from __future__ import annotations

import abc
import functools
import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import ttus_opt.benchmark.parts
from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.row import MEASURED, Row, RunSpec, Settings
from ttus_opt.report.document import Block, Heading, Table, Text

#: Points of the probe's shell in parts whose time depends on their number
SHELL_POINTS = 5000


@dataclass(frozen=True)
class Column:
    """A column of a table: its header, the key of its value, and its format."""

    header: str
    key: str
    written: Callable[[Any], str] = str


class Part(abc.ABC):
    """A part of the benchmark.

    Attributes:
        name: On the command line, and of its CSV file.
        key: Key of its rows in the JSON; "" for the name.
        title: Heading of its table.
        legend: Meaning of the columns, for the report.
        columns: Columns of its table, after the case.
        options: Options of every run, unless `plan` is overridden.
        parallel: Whether its runs may be parallel.
    """

    name: str
    key: str = ""
    title: str
    legend: str
    columns: Sequence[Column]
    options: ClassVar[Mapping[str, Any]] = {}
    parallel: bool = False

    def plan(self, cases: Sequence[CaseSpec], settings: Settings) -> list[RunSpec]:
        """The runs for given cases; by default one for each.

        Raises:
            InputError: An unknown name in the settings, or a number out of range.
        """
        return [
            RunSpec(self.name, self.prepared(case), self.options, settings.time_limit)
            for case in cases
        ]

    def prepared(self, case: CaseSpec) -> CaseSpec:
        """The case as this part measures it; by default unchanged."""
        return case

    @abc.abstractmethod
    def measure(self, spec: RunSpec, begin: Progress) -> list[Row]:
        """Measure one run in this process.

        Args:
            spec: One of `plan`.
            begin: Call it with the name of each stage as it begins; those of
                `isolation.PREPARING` may take longer than the time limit.

        Returns:
            Rows of plain numbers and strings, with the keys of `columns` and others.
        """

    def refused(self, specs: Sequence[RunSpec]) -> dict[str, Row]:
        """Rows of runs that would fail, known without starting a process."""
        return {}

    def row(self, spec: RunSpec, status: str, detail: str) -> Row:
        """The row of a run without values.

        Args:
            spec: The run.
            status: `MEASURED`, or the kind of failure.
            detail: An explanation.
        """
        common = {"case": spec.case_name, "status": status, "detail": detail}
        return {"key": spec.key, **common, **spec.options}

    def finished(
        self, rows: Sequence[Row], settings: Settings, output: Path
    ) -> list[Row]:
        """Rows completed with values that depend on all rows; by default unchanged."""
        return list(rows)

    def table(self, rows: Sequence[Row]) -> Table:
        """All rows, with failures explained in the last column."""
        header = ["case", *(column.header for column in self.columns), "remark"]
        body = [
            [row["case"], *(_cell(c, row) for c in self.columns), _remark(row)]
            for row in rows
        ]
        return Table(header, body)

    def below(self, rows: Sequence[Row]) -> list[Block]:
        """What the report has below the table; nothing by default."""
        return []

    def text(self, rows: Sequence[Row], settings: Settings) -> list[Block]:
        """All rows for the terminal."""
        return [Text(f"{self.title}:"), self.table(rows), *self.below(rows)]

    def report(self, rows: Sequence[Row], settings: Settings) -> list[Block]:
        """Its sections of the report."""
        head = [Heading(self.title), Text(self.legend), self.table(rows)]
        return [*head, *self.below(rows)]


def _cell(column: Column, row: Row) -> str:
    value = row.get(column.key)
    return "–" if value is None else column.written(value)


def _remark(row: Row) -> str:
    words = [row["status"]] if row["status"] != MEASURED else []
    words += [row["detail"]] if row["detail"] else []
    return ": ".join(words).replace("|", "/")


#: The first part, and the default
SOLVERS = "solvers"


@functools.cache
def parts() -> dict[str, Part]:
    """Every part by name."""
    listed: list[Part] = []
    for module in pkgutil.iter_modules(ttus_opt.benchmark.parts.__path__):
        loaded = importlib.import_module(f"ttus_opt.benchmark.parts.{module.name}")
        listed += [loaded.PART] if hasattr(loaded, "PART") else []
    listed.sort(key=lambda part: (part.name != SOLVERS, part.name))
    return {part.name: part for part in listed}
