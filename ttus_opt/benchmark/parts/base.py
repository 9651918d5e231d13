"""What a part of the benchmark is: what it measures, and the columns of its table.

A part is added by adding a file with ``PART`` to this folder.
"""

from __future__ import annotations

import abc
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.stages import Stages
from ttus_opt.report.tables import table

#: Points of the probe's shell where the shell's size decides the time
SHELL_POINTS = 5000

#: Status of a row that has its figures
MEASURED = "measured"

#: Stages that compile and build, whatever the part's time limit is
PREPARING = ("start", "warm-up", "scene")

Figures = dict[str, Any]


@dataclass(frozen=True)
class PartSpec:
    """One run of a part, in a process of its own.

    Attributes:
        part: The part's name.
        case: The scene; None where the part brings its own.
        options: The part's own.
        time_limit: Most seconds of one stage [s].
    """

    part: str
    case: CaseSpec | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    time_limit: float = 600.0

    @property
    def case_name(self) -> str:
        """For the tables; "–" without a case."""
        return "–" if self.case is None else self.case.name

    @property
    def key(self) -> str:
        """The same for the same question, to resume by."""
        text = json.dumps(self.as_dict(), sort_keys=True)
        digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        name = "any" if self.case is None else self.case.name
        return f"{self.part}-{name}-{digest}"

    def as_dict(self) -> dict[str, Any]:
        """Everything, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> PartSpec:
        """Read back what `as_dict` gave."""
        case = values["case"]
        return cls(
            **{**values, "case": None if case is None else CaseSpec.from_dict(case)}
        )


@dataclass(frozen=True)
class Column:
    """A column of a part's table.

    Attributes:
        header: With its unit.
        key: Of the figure in a row.
        written: How the figure is written.
    """

    header: str
    key: str
    written: Callable[[Any], str] = str


class Part(abc.ABC):
    """A part of the benchmark.

    Attributes:
        name: By which it is asked for, and its key in the JSON.
        title: Heading of its table.
        legend: What the columns mean, for the report.
        columns: Of its table, after the case.
    """

    name: str
    title: str
    legend: str
    columns: Sequence[Column]

    def plan(self, cases: Sequence[CaseSpec], time_limit: float) -> list[PartSpec]:
        """The runs for given cases; by default one for each.

        Args:
            cases: The scenes.
            time_limit: Most seconds of one stage [s].
        """
        return [PartSpec(self.name, case, {}, time_limit) for case in cases]

    @abc.abstractmethod
    def measure(self, spec: PartSpec, begin: Stages) -> list[Figures]:
        """Measure one run in this process.

        Args:
            spec: One of `plan`.
            begin: To be called with every stage that begins; those of `PREPARING`
                may take longer than the time limit.

        Returns:
            Rows: plain numbers and words by the keys of `columns` and others.
        """

    def table(self, rows: Sequence[Mapping[str, Any]]) -> str:
        """All rows of this part as a Markdown table.

        Args:
            rows: Of all its runs; those that failed say why in the last column.
        """
        header = ["case", *(column.header for column in self.columns), "remark"]
        body = [
            [
                str(row["case"]),
                *(_cell(column, row.get(column.key)) for column in self.columns),
                _remark(row),
            ]
            for row in rows
        ]
        return table(header, body)

    def below(self, rows: Sequence[Mapping[str, Any]], folder: Path) -> list[str]:
        """What the report says below the table; pictures it names are written.

        Args:
            rows: Of all its runs, those that failed as well.
            folder: Where pictures go.

        Returns:
            Lines of Markdown; none by default.
        """
        return []


def scene_case(spec: PartSpec) -> CaseSpec:
    """The case of a run that has one."""
    assert spec.case is not None, f"{spec.part} is planned without a case"
    return spec.case


def _cell(column: Column, value: Any) -> str:
    return "–" if value is None else column.written(value)


def _remark(row: Mapping[str, Any]) -> str:
    told = [row["status"]] if row["status"] != MEASURED else []
    told += [row["detail"]] if row["detail"] else []
    return ": ".join(told).replace("|", "/")
