"""What a user asks of the runs, beside the cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ttus_opt.solvers.base import Solver

#: Weight of force and torque rows by default [–]
WEIGHT = 1e-2

#: The same by option, as it is given to every formulation that has them
WEIGHTS = {"force_weight": WEIGHT, "torque_weight": WEIGHT}

#: Among formulations or solvers: every one there is, or that is installed
ALL = "all"

#: As the reference: `CLOSED_FORM` where it fits the case
AUTO = "auto"

#: The reference by default, and the largest case it fits [voxels]: factorising Q takes
#: time ∝ V² (a minute on S), and passes the default time limit soon beyond
CLOSED_FORM, CLOSED_FORM_FITS = "closed_form", 100_000


@dataclass(frozen=True)
class Settings:
    """Settings of a benchmark; all but the time limit are of the solvers' part alone.

    Attributes:
        time_limit: Most seconds of one solve, or of one stage of another part [s].
        formulations: Names, paths, or `ALL`.
        solvers: Names, paths of files with ``SOLVERS``, or solvers; empty or `ALL` for
            every one installed, closed forms on cases of up to `CLOSED_FORM_FITS`
            voxels only.
        closed_form: Name of the solver whose answer is the reference; "" for none;
            `AUTO` for the closed form on cases of up to `CLOSED_FORM_FITS` voxels.
        options: Formulation options beside the weights.
        tolerance: Largest relative KKT residual of a solution [–].
        repeat: How many times each is measured.
        weight: Of force and torque rows in every formulation that has them [–].
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
