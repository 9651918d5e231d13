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
        dual_margin: Relative residual of the last dual over the KKT tolerance [–].
        tightenings: Most attempts, each more accurate, until the KKT residuals hold:
            the dual's residual is relative to the measurements, the tolerance to what
            is left where these nearly cancel [–].
        tightening: Factor on the dual's residual from one attempt to the next [–].
        refinements: Most rounds of iterative refinement of a dual [–].
        loosest_product: Largest relative residual of a solve inside a product; a
            hundredth of the dual's own if that is more. At 1e-4, weights of 1e4 and
            contradictory measurements take more directions [–].
        divergence: If a dual residual has grown by this factor, the Schur complement is
            too large for a preconditioner in single precision, and the best answer so
            far is kept. Growth by the square root of its condition number is normal,
            1e5 at weights of 1e6 [–].
        max_directions: Most new directions of a dual solve, and most directions of the
            preconditioner [–].
        preconditioner_residual: Relative residual at which a preconditioner stops [–].
        preconditioner_energy: Relative error in the energy norm at which it stops too:
            the residual may stall in single precision [–].
        preconditioner_delay: Steps over which that error is estimated (Hestenes and
            Stiefel's rule; Strakoš and Tichý, ETNA 13, 2002) [–].
        warm_start: A subproblem starts from the previous field if it is solved to this
            relative residual or better; otherwise the start costs more than it saves
            [–].
        max_working_sets: Most working sets [–].
        subproblem_accuracy: Relative residual of a working set's dual over its worst
            KKT violation [–].
        loosest_subproblem: Largest relative residual of a working set's dual [–].
        predicted_subproblem: Relative residual of the dual of a working set that a
            model predicts: the next prediction needs no more [–].
        field_accuracy: Relative residual of the solves for a field, except the last,
            over its dual's [–].
        acceptable: KKT violation that may remain, over the KKT tolerance: thousands of
            limits may be so close to active that it hardly matters which ones are [–].
        acceptable_sets: Number of working sets with only such violations before the
            iteration ends [–].
        patience: Iterations without progress before the safeguard [–].
        progress: It is progress if the worst violation or their number falls below
            this fraction of the least so far, or if more limits are active than ever
            [–].
        share: An order constraint along spokes becomes active if its violation is at
            least this share of the worst in its neighbourhood; less if the worst
            relative violation of all is below a tenth [–].
        bound_share: Besides local maxima, a bound becomes active if its violation is at
            least a share of the worst in its neighbourhood. The share falls from 1 to
            this value as long as few wrong signs follow [–].
        neighbourhood: Number of voxels to each side in a neighbourhood [–].
    """

    dual_margin: float = _option(1e-2, 1e-4, 1.0, 1.0)
    tightenings: int = _option(4, 1, 10, 1)
    tightening: float = _option(1e-3, 1e-6, 0.1, 0.1)
    refinements: int = _option(8, 1, 20, 1)
    loosest_product: float = _option(1e-5, 0.0, 1e-3, 0.0, 1e-4)
    divergence: float = _option(1e6, 10.0, 1e300, 1e300)
    max_directions: int = _option(2000, 1, 10_000)
    preconditioner_residual: float = _option(0.002, 1e-4, 0.1, 0.05)
    preconditioner_energy: float = _option(0.01, 0.0, 0.5, 0.0, 0.1)
    preconditioner_delay: int = _option(4, 1, 20, 1)
    warm_start: float = _option(3e-4, 0.0, 1.0, 0.0, 1.0)
    max_working_sets: int = _option(100, 1, 10_000)
    subproblem_accuracy: float = _option(1e-2, 0.0, 1.0, 0.0, 0.1)
    loosest_subproblem: float = _option(1e-3, 1e-6, 0.1, 1e-4, 1e-2)
    predicted_subproblem: float = _option(1e-2, 1e-6, 0.1, 1e-3)
    field_accuracy: float = _option(1e-3, 0.0, 0.1, 0.0)
    acceptable: float = _option(0.1, 0.0, 1.0, 0.0)
    acceptable_sets: int = _option(2, 0, 100, 0)
    patience: int = _option(5, 0, 10_000, 0, 10_000)
    progress: float = _option(0.8, 0.1, 1.0, 1.0)
    share: float = _option(0.3, 0.01, 1.0, 0.1, 1.0)
    bound_share: float = _option(0.4, 0.01, 1.0, 0.7, 1.0)
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
