"""Parameters of conjugate gradients on the normal equations."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PrimalOptions:
    """Options of the method.

    Attributes:
        inner: Residual of the preconditioner's dual system, over the energy norm of
            its solution [–].
        few_rows: Most rows of a term that is eliminated through its dual [–].
    """

    inner: float = 0.1
    few_rows: int = 1000
