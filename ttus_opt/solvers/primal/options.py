"""The numbers of the method in one place: meaning and what each buys."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PrimalOptions:
    """Options of conjugate gradients on the normal equations.

    Attributes:
        gap_margin: What a solve leaves of the gap over what the tolerance allows:
            the check outside knows the gap by a bound only [–].
        dual_margin: The same of the gradient [–].
        inner: Residual of the preconditioner's dual system over the energy norm of
            what it answers [–].
        max_steps: Most steps of a solve [–].
        rounds: Most rounds of a solve, each from a residual computed anew [–].
        round_gain: They end where one leaves more than this part of the gap [–].
        tightenings: Most times a solve is repeated more exactly [–].
        tightening: By how much each time, of the gap [–].
        few_rows: Most rows of a term that the dual may take, measured or not [–].
        keep_matched: Weights may change by this factor before the preconditioner is
            made anew [–].
    """

    gap_margin: float = 1e-3
    dual_margin: float = 0.1
    inner: float = 0.1
    max_steps: int = 500
    rounds: int = 8
    round_gain: float = 0.5
    tightenings: int = 4
    tightening: float = 1e-3
    few_rows: int = 4096
    keep_matched: float = 3.0
