"""One run: what it was asked, and what a row of its answer is, as plain data."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from ttus_opt.benchmark.cases import CaseSpec

#: Figures by name, for JSON. Every row has ``key``, ``case``, ``status``, ``detail``,
#: ``peak_memory_bytes`` and ``memory_by_stage``; the rest is its part's
Row = dict[str, Any]

#: Status of a row that has its figures; that of a solver's row is ``solved``
MEASURED = "measured"


@dataclass(frozen=True)
class RunSpec:
    """One run of a part of the benchmark, in a process of its own.

    Attributes:
        part: The part's name.
        case: The scene; None where the part brings its own.
        options: The part's own.
        time_limit: Most seconds of one stage that computes [s].
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
        """For people: the case, the part, and what tells its runs apart."""
        told = ("formulation", "solver", "sampling", "voxel")
        words = [str(self.options[name]) for name in told if name in self.options]
        return " ".join([self.case_name, *(words or [self.part])])

    @property
    def scene_case(self) -> CaseSpec:
        """The case of a run that has one."""
        assert self.case is not None, f"{self.part} is planned without a case"
        return self.case

    @property
    def key(self) -> str:
        """The same for the same question, to resume by."""
        text = json.dumps(self.as_dict(), sort_keys=True)
        digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        return f"{self.part}-{self.case.name if self.case else 'any'}-{digest}"

    def as_dict(self) -> dict[str, Any]:
        """Everything, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> RunSpec:
        """Read back what `as_dict` gave."""
        case = values["case"] and CaseSpec.from_dict(values["case"])
        return cls(**{**values, "case": case})
