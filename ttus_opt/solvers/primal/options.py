"""Parameters of conjugate gradients on the normal equations."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PrimalOptions:
    """Options of the method.

    Attributes:
        gap_margin: Gap aimed for, over the tolerance; small, because the final check
            knows only a bound of the gap [–].
        dual_margin: Gradient aimed for, over the tolerance [–].
        inner: Residual of the preconditioner's dual system, over the energy norm of
            its solution [–].
        max_steps: Most steps of a solve [–].
        rounds: Most rounds of a solve, each from a recomputed residual [–].
        round_gain: Stop when a round leaves more than this part of the gap [–].
        tightenings: Most repetitions of a solve with a smaller gap [–].
        tightening: Factor on the gap at each repetition [–].
        few_rows: Most rows of a term that is eliminated through its dual [–].
    """

    gap_margin: float = 1e-3
    dual_margin: float = 0.1
    inner: float = 0.1
    max_steps: int = 300
    rounds: int = 8
    round_gain: float = 0.5
    tightenings: int = 3
    tightening: float = 1e-3
    few_rows: int = 1000
