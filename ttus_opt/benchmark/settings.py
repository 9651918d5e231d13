"""Settings of a benchmark, beside its cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ttus_opt.solvers.base import Solver

#: Default weight of force and torque rows [–]
WEIGHT = 1e-2

#: The weights as options of formulations
WEIGHTS = {"force_weight": WEIGHT, "torque_weight": WEIGHT}

#: Every formulation, or every installed solver
ALL = "all"

#: Reference `CLOSED_FORM` on cases that are small enough
AUTO = "auto"

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
