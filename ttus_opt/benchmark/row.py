"""A run, its settings and its rows, as plain data."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.solvers.base import Solver

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
        text = json.dumps(asdict(self), sort_keys=True)
        digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        return f"{self.part}-{self.case.name if self.case else 'any'}-{digest}"

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> RunSpec:
        """Inverse of `dataclasses.asdict`."""
        case = values["case"] and CaseSpec.from_dict(values["case"])
        return cls(**{**values, "case": case})


#: Default weight of force and torque rows [–]
WEIGHT = 1e-2

#: The weights as options of formulations
WEIGHTS = {"force_weight": WEIGHT, "torque_weight": WEIGHT}

#: Every formulation, or every installed solver
ALL = "all"

#: The solver that `tt.fit` chooses; the reference `CLOSED_FORM` on cases that are small
#: enough
AUTO: Literal["auto"] = "auto"

#: The default reference, and its largest case [voxels]: factorising Q takes time ∝ V²
#: (a minute on S), and soon exceeds the default time limit
CLOSED_FORM, CLOSED_FORM_FITS = "closed_form", 100_000


@dataclass(frozen=True)
class Settings:
    """Settings of a benchmark; all but the time limit are for the solvers' part only.

    Attributes:
        time_limit: Longest duration of a solve, or of a stage of another part [s].
        formulations: Names, paths, or `ALL`.
        solvers: Names, paths of files with ``SOLVERS``, or solvers; empty or `ALL` for
            every one installed, closed forms on cases of up to `CLOSED_FORM_FITS`
            voxels only.
        closed_form: Name of the solver whose answer is the reference; "" for none;
            `AUTO` for the closed form on cases of up to `CLOSED_FORM_FITS` voxels.
        options: Formulation options beside the weights.
        tolerance: Largest relative KKT residual of a solution [–].
        repeat: Number of repetitions.
        weight: Weight of force and torque rows, in formulations that have them [–].
        memory: Show the memory of each stage.
    """

    time_limit: float = 600.0
    formulations: Sequence[str] = ("eq10",)
    solvers: Sequence[str | Path | Solver] = ()
    closed_form: str = AUTO
    options: Mapping[str, Any] = field(default_factory=dict)
    tolerance: float = 1e-6
    repeat: int = 1
    weight: float = WEIGHT
    memory: bool = False

    @property
    def reference(self) -> str:
        """Name of the reference on cases that have one; "" for none at all."""
        return CLOSED_FORM if self.closed_form == AUTO else self.closed_form
