"""One run, what it was asked and what came of it, as plain data."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from ttus_opt.benchmark.cases import CaseSpec

#: Statuses that are no failure of the solver: it was never run
NOT_RUN = ("refused", "not installed")


@dataclass(frozen=True)
class RunSpec:
    """One solver on one formulation of one case.

    Attributes:
        case: The scene.
        formulation: A name or the path of a user's file.
        solver: A solver's name.
        options: The formulation's options.
        tolerance: Largest relative KKT residual of a solution [–].
        time_limit: Most seconds for one solve, set-up included [s].
        repeat: How many times first and again are measured.
    """

    case: CaseSpec
    formulation: str
    solver: str
    options: Mapping[str, Any] = field(default_factory=dict)
    tolerance: float = 1e-6
    time_limit: float = 600.0
    repeat: int = 1

    def as_dict(self) -> dict[str, Any]:
        """Everything, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> RunSpec:
        """Read back what `as_dict` gave."""
        return cls(**{**values, "case": CaseSpec.from_dict(values["case"])})

    @property
    def key(self) -> str:
        """The same for the same question, to resume by."""
        text = json.dumps(self.as_dict(), sort_keys=True)
        digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        return f"{self.case.name}-{self.label}-{self.solver}-{digest}"

    @property
    def label(self) -> str:
        """The formulation's name without folder and suffix."""
        return self.formulation.replace("\\", "/").rsplit("/", 1)[-1].split(".py")[0]


@dataclass(frozen=True)
class Row:
    """What came of a run.

    Attributes:
        key: The run's.
        case: Its name.
        formulation: Its name.
        solver: Its name.
        status: ``solved``, or why not: the solution's status, ``refused``, ``not
            installed``, ``time limit``, ``memory limit``, ``crashed``.
        voxels: V [–].
        poses: T [–].
        time_limit: Of the run [s].
        seconds_assembly: Scene and program [s].
        seconds_first: Set-up and first solve, median of the repeats [s].
        seconds_again: Taking in other measured values and solving again, median [s].
        seconds_each: Every repeat's ``first`` and ``again`` [s].
        peak_memory_bytes: Largest resident size of the run's own process from its
            first import to its end; of one that was ended, the largest that was seen;
            None where none was begun (refused, not installed) [byte].
        solver_memory_bytes: What set-up and solve added to it at most.
        memory_by_stage: Largest size of the process per stage.
        kkt: Residuals verified here, absolute and relative.
        objective: At the answer.
        iterations: Of the first solve.
        active_limits: Bounds and inequality rows with a multiplier that is not zero;
            None without a verified answer [–].
        objective_gap: Over the best verified objective, relative; None before all
            rows are there.
        difference_from_closed_form: Euclidean norm of the difference of the fields
            over that of the closed form's; None where that has no answer.
        detail: In words.
        field_file: Name of the file with p, shape (V,); empty without one.
    """

    key: str
    case: str
    formulation: str
    solver: str
    status: str
    voxels: int
    poses: int | None
    time_limit: float
    seconds_assembly: float | None = None
    seconds_first: float | None = None
    seconds_again: float | None = None
    seconds_each: Mapping[str, list[float]] = field(default_factory=dict)
    peak_memory_bytes: int | None = None
    solver_memory_bytes: int | None = None
    memory_by_stage: Mapping[str, int] = field(default_factory=dict)
    kkt: Mapping[str, float | None] | None = None
    objective: float | None = None
    iterations: int | None = None
    active_limits: int | None = None
    objective_gap: float | None = None
    difference_from_closed_form: float | None = None
    detail: str = ""
    field_file: str = ""

    @property
    def solved(self) -> bool:
        """Whether the answer passed the check."""
        return self.status == "solved"

    @property
    def was_run(self) -> bool:
        """Whether the solver was there and could take the problem."""
        return self.status not in NOT_RUN

    @property
    def worst_relative(self) -> float | None:
        """The largest relative residual [–]."""
        if self.kkt is None:
            return None
        relative = (v for k, v in self.kkt.items() if k.endswith("_relative"))
        return max(v for v in relative if v is not None)

    def as_dict(self) -> dict[str, Any]:
        """Everything, for JSON."""
        return asdict(self)

    @classmethod
    def failed(cls, spec: RunSpec, status: str, detail: str, **known: Any) -> Row:
        """A row of a run that has no answer."""
        return cls(
            spec.key,
            spec.case.name,
            spec.label,
            spec.solver,
            status,
            spec.case.n_voxels,
            spec.case.n_poses,
            spec.time_limit,
            detail=detail,
            **known,
        )
