"""What a part of the benchmark is: what it measures, and the columns of its table.

A part is added by adding a file with ``PART`` to this folder.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.progress import Progress
from ttus_opt.benchmark.row import MEASURED, Row, RunSpec
from ttus_opt.benchmark.settings import Settings
from ttus_opt.report.tables import table

#: Points of the probe's shell where the shell's size decides the time
SHELL_POINTS = 5000


@dataclass(frozen=True)
class Column:
    """A column of a table: its header, the key of its figure, and how it is written."""

    header: str
    key: str
    written: Callable[[Any], str] = str


class Part(abc.ABC):
    """A part of the benchmark.

    Attributes:
        name: By which it is asked for, and the name of its CSV file.
        key: Of its rows in the JSON, where that is another; "" for the name.
        title: Heading of its table.
        legend: What the columns mean, for the report.
        columns: Of its table, after the case.
        options: Of every run, where `plan` is not overridden.
        parallel: Whether its runs may be several at a time.
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

        Args:
            cases: The scenes.
            settings: What was asked for.

        Raises:
            InputError: Something asked for is not there or out of range.
        """
        return [
            RunSpec(self.name, self.prepared(case), self.options, settings.time_limit)
            for case in cases
        ]

    def prepared(self, case: CaseSpec) -> CaseSpec:
        """The case as this part measures it; by default as it is."""
        return case

    @abc.abstractmethod
    def measure(self, spec: RunSpec, begin: Progress) -> list[Row]:
        """Measure one run in this process.

        Args:
            spec: One of `plan`.
            begin: To be called with every stage that begins; those of
                `isolation.PREPARING` may take longer than the time limit.

        Returns:
            Rows: plain numbers and words by the keys of `columns` and others.
        """

    def refused(self, specs: Sequence[RunSpec]) -> dict[str, Row]:
        """Of runs that are to begin, rows of those that need no process to fail."""
        return {}

    def row(self, spec: RunSpec, status: str, detail: str) -> Row:
        """The row of a run before there are figures, or without any.

        Args:
            spec: The run.
            status: `MEASURED`, or why there are none.
            detail: In words.
        """
        told = {"case": spec.case_name, "status": status, "detail": detail}
        return {"key": spec.key, **told, **spec.options}

    def finished(
        self, rows: Sequence[Row], settings: Settings, output: Path
    ) -> list[Row]:
        """Rows with what only all of them together tell; as they are by default."""
        return list(rows)

    def table(self, rows: Sequence[Row]) -> str:
        """All rows as a Markdown table; a failed one says why in the last column."""
        header = ["case", *(column.header for column in self.columns), "remark"]
        body = [
            [row["case"], *(_cell(c, row) for c in self.columns), _remark(row)]
            for row in rows
        ]
        return table(header, body)

    def below(self, rows: Sequence[Row]) -> list[str]:
        """What is said below the table, in Markdown; nothing by default."""
        return []

    def text(self, rows: Sequence[Row], settings: Settings) -> str:
        """What the terminal shows of all its rows."""
        below = ["", *self.below(rows)]
        return "\n".join([f"{self.title}:", self.table(rows), *below]).rstrip()

    def report(
        self, rows: Sequence[Row], settings: Settings, folder: Path
    ) -> list[str]:
        """Its sections of the report, in Markdown; writes their pictures.

        Args:
            rows: Of all its runs.
            settings: What was asked for.
            folder: Of the results.
        """
        head = [f"## {self.title}", "", self.legend, "", self.table(rows), ""]
        return head + self.below(rows)


def _cell(column: Column, row: Row) -> str:
    value = row.get(column.key)
    return "–" if value is None else column.written(value)


def _remark(row: Row) -> str:
    told = [row["status"]] if row["status"] != MEASURED else []
    told += [row["detail"]] if row["detail"] else []
    return ": ".join(told).replace("|", "/")
