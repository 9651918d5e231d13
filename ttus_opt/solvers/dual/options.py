"""The numbers of the method in one place: meaning, range, and what each buys.

`benchmarks/ablation.py` solves problems with many active limits, each option at the
values given here as its trials, and prints V-cycles, working sets and KKT residuals.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, fields
from typing import Any

from ttus_opt.errors import InputError
from ttus_opt.laplace.system import RTOL


def _option(default: Any, low: float, high: float, *trials: float) -> Any:
    """A number with its range and the values that an ablation tries."""
    return field(default=default, metadata={"range": (low, high), "trials": trials})


@dataclass(frozen=True)
class DualOptions:
    """Options of the structured solver.

    Attributes:
        dual_margin: Residual of the last dual over the KKT tolerance [–].
        tightenings: Most times a dual is solved more exactly where the KKT residuals
            do not hold: its residual is relative to measurements, the tolerance to
            what these leave of each other [–].
        tightening: By how much each time [–].
        refinements: Most rounds of iterative refinement of a dual [–].
        loosest_product: Largest relative residual of a solve inside a product; a
            hundredth of the dual's own where that is more. At 1e-4 weights of 1e4, and
            measurements that contradict each other, take more directions [–].
        divergence: A dual residual that has grown by this factor will not come back:
            the Schur complement is too large for a preconditioner in single precision,
            and the best answer so far is kept. By the root of S's condition it may
            grow, 1e5 at weights of 1e6 [–].
        max_directions: Most new directions of a dual solve, and most of the
            preconditioner [–].
        preconditioner_residual: To which part the preconditioner reduces a residual,
        preconditioner_energy: or the error in the energy norm: the residual may stall
            at what single precision leaves [–].
        preconditioner_delay: Steps over which that error is estimated (Hestenes and
            Stiefel's rule; Strakoš and Tichý, ETNA 13, 2002) [–].
        warm_start: A subproblem starts from the field of the one before where it is
            solved to this relative residual or better: a start costs a response, and
            gains less than that where less is asked for [–].
        max_working_sets: Most working sets [–].
        subproblem_accuracy: Relative residual of a working set's dual over its worst
            KKT violation [–].
        loosest_subproblem: The same, at most [–].
        predicted_subproblem: The same of a working set that a model predicts: the next
            prediction needs no more [–].
        field_accuracy: Residual of the solves behind a field that is not the last, over
            its dual's [–].
        acceptable: Which KKT violation may remain, over the KKT tolerance: thousands of
            limits may lie so near to active that it hardly matters which of them are
            [–].
        acceptable_sets: After how many working sets with no more than that [–].
        patience: Iterations without progress before the safeguard [–].
        progress: The worst violation or their number has to fall below this part of
            the least so far, or the active limits to become more than ever [–].
        share: An order constraint along spokes joins the working set where it is
            violated by this share of the worst in its neighbourhood; by less where
            the worst of all, relative, is below a tenth [–].
        bound_share: A bound joins with the peaks of the violation where it is violated
            by a share of the worst in its neighbourhood: of 1 at first, of this at
            least, as long as few wrong signs follow [–].
        neighbourhood: How many voxels to each side are compared [–].
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
    """How exactly a dual is solved, and until when.

    Attributes:
        rtol: Residual of the dual, relative to t - D p₀ [–].
        field_rtol: Relative residual of the solves behind the answer's field [–].
        deadline: `time.perf_counter` at which to stop; None for never [s].
    """

    rtol: float
    field_rtol: float = RTOL
    deadline: float | None = None

    @property
    def late(self) -> bool:
        """Whether the deadline is over."""
        return self.deadline is not None and time.perf_counter() > self.deadline
