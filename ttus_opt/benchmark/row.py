"""A run and its rows, as plain data."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from ttus_opt.benchmark.cases import CaseSpec

#: Values by name, for JSON. Every row has ``key``, ``case``, ``status``, ``detail``,
#: ``peak_memory_bytes`` and ``memory_by_stage``; the rest depends on the part
Row = dict[str, Any]

#: Status of a successful row; in the solvers' part it is ``solved``
MEASURED = "measured"


@dataclass(frozen=True)
class RunSpec:
    """One run of a part of the benchmark, in a process of its own.

    Attributes:
        part: The part's name.
        case: The scene; None if the part has its own.
        options: Options of the part.
        time_limit: Longest duration of a computing stage [s].
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
    def title(self) -> str:
        """A readable name: the case, and the options that distinguish its runs."""
        shown = ("formulation", "solver", "sampling", "voxel", "what")
        words = [str(self.options[name]) for name in shown if name in self.options]
        return " ".join([self.case_name, *(words or [self.part])])

    @property
    def scene_case(self) -> CaseSpec:
        """The case of a run that has one."""
        assert self.case is not None, f"{self.part} is planned without a case"
        return self.case

    @property
    def key(self) -> str:
        """Identifies the run, to resume by."""
        text = json.dumps(self.as_dict(), sort_keys=True)
        digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        return f"{self.part}-{self.case.name if self.case else 'any'}-{digest}"

    def as_dict(self) -> dict[str, Any]:
        """The run, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> RunSpec:
        """Inverse of `as_dict`."""
        case = values["case"] and CaseSpec.from_dict(values["case"])
        return cls(**{**values, "case": case})
