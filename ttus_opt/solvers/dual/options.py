"""The numerical parameters of the method, with meaning and range.

`benchmarks/ablation.py` solves problems with many active limits at the trial values
given here and prints V-cycles, working sets and KKT residuals.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, fields
from typing import Any

from ttus_opt.core.errors import InputError
from ttus_opt.laplace.system import RTOL


def _option(default: Any, low: float, high: float, *trials: float) -> Any:
    """A default with its range and the trial values of the ablation."""
    return field(default=default, metadata={"range": (low, high), "trials": trials})


@dataclass(frozen=True)
class DualOptions:
    """Options of the structured solver.

    Attributes:
        refinements: Most rounds of iterative refinement of a dual [–].
        loosest_product: Largest relative residual of a solve inside a product; a
            hundredth of the dual's own if that is more. At 1e-4, weights of 1e4 and
            contradictory measurements take more directions [–].
        max_directions: Most new directions of a dual solve, and most directions of the
            preconditioner [–].
        preconditioner_residual: Relative residual at which a preconditioner stops [–].
        preconditioner_energy: Relative error in the energy norm at which it stops too:
            the residual may stall in single precision [–].
        preconditioner_delay: Steps over which that error is estimated (Hestenes and
            Stiefel's rule; Strakoš and Tichý, ETNA 13, 2002) [–].
        max_working_sets: Most working sets [–].
        subproblem_accuracy: Relative residual of a working set's dual over its worst
            KKT violation [–].
        loosest_subproblem: Largest relative residual of a working set's dual [–].
        field_accuracy: Relative residual of the solves for a field, except the last,
            over its dual's [–].
        patience: Iterations without progress before the safeguard [–].
        share: An order constraint along spokes becomes active if its violation is at
            least this share of the worst in its neighbourhood; less if the worst
            relative violation of all is below a tenth [–].
        neighbourhood: Number of voxels to each side in a neighbourhood [–].
    """

    refinements: int = _option(8, 1, 20, 1)
    loosest_product: float = _option(1e-5, 0.0, 1e-3, 0.0, 1e-4)
    max_directions: int = _option(2000, 1, 10_000)
    preconditioner_residual: float = _option(0.002, 1e-4, 0.1, 0.05)
    preconditioner_energy: float = _option(0.01, 0.0, 0.5, 0.0, 0.1)
    preconditioner_delay: int = _option(4, 1, 20, 1)
    max_working_sets: int = _option(100, 1, 10_000)
    subproblem_accuracy: float = _option(1e-2, 0.0, 1.0, 0.0, 0.1)
    loosest_subproblem: float = _option(1e-3, 1e-6, 0.1, 1e-4, 1e-2)
    field_accuracy: float = _option(1e-3, 0.0, 0.1, 0.0)
    patience: int = _option(5, 0, 10_000, 0, 10_000)
    share: float = _option(0.3, 0.01, 1.0, 0.1, 1.0)
    neighbourhood: int = _option(4, 1, 16, 1)

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            InputError: A number lies outside its range.
        """
        for option in fields(self):
            low, high = option.metadata["range"]
            value = getattr(self, option.name)
            if not low <= value <= high:
                raise InputError(
                    f"{option.name} must lie between {low:g} and {high:g}, got {value}"
                )


@dataclass(frozen=True)
class Accuracy:
    """Accuracy and deadline of a dual solve.

    Attributes:
        rtol: Residual of the dual, relative to t - D p₀ [–].
        field_rtol: Relative residual of the solves for the answer's field [–].
        deadline: `time.perf_counter` at which to stop [s]; None for never.
    """

    rtol: float
    field_rtol: float = RTOL
    deadline: float | None = None

    @property
    def late(self) -> bool:
        """Whether the deadline has passed."""
        return self.deadline is not None and time.perf_counter() > self.deadline
