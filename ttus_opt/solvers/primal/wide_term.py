"""A sum of squares of many short rows, over the field alone."""

from __future__ import annotations

from dataclasses import dataclass, field

import scipy.sparse as sp

from ttus_opt.arrays import Array


@dataclass(frozen=True)
class WideTerm:
    """w ‖M p - t‖² with many short rows.

    Attributes:
        weight: w over the prior's weight [–].
        matrix: M, shape (m, V).
        target: t, shape (m,).
    """

    weight: float
    matrix: sp.csr_array = field(repr=False)
    target: Array = field(repr=False)
