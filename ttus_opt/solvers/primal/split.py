"""A program's sums of squares, sorted into prior, wide terms and few rows.

Divided by the weight of the Laplace term the objective is

    (L p - b)ᵀΩ⁻¹(L p - b) + Σ_k w_k ‖M_k p - t_k‖² + ‖D p + E c - t‖²

with the Laplace term first, *wide* terms M_k of many short rows, and few rows D, which
include the measurements. c are the unknowns beside the field.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.solvers.dual.data import DualData

#: Most rows of a term, other than measurements, that is eliminated through its dual
FEW_ROWS = 1000


@dataclass(frozen=True)
class Split:
    """A program's objective over its prior's weight.

    Attributes:
        prior: The Laplace term, of weight 1.
        wide: The wide terms.
        few: Dual data of the prior and the few rows.
        moving: Voxels whose value is not given, shape (V,).
    """

    prior: ProgramTerm
    wide: tuple[ProgramTerm, ...]
    few: DualData
    moving: Mask = field(repr=False)

    @classmethod
    def of(cls, program: Program, few_rows: int = FEW_ROWS) -> Split:
        """Read a program whose Laplace term has rows over p alone.

        Args:
            program: The program.
            few_rows: Most rows of a term that is not wide.
        """
        prior = program.laplace_prior
        assert prior is not None
        wide = [t for t in wide_terms(program, few_rows) if t.weight > 0.0]
        others = [t for t in program.terms if not any(t is k for k in (prior, *wide))]
        few = DualData.of(program, [t for t in others if t.weight > 0.0])
        hard = program.dirichlet is not None
        moving = program.laplace.free | np.full(len(few.b), not hard)
        own = [_over(t, prior.weight, len(few.b)) for t in (prior, *wide)]
        return cls(own[0], tuple(own[1:]), few, moving)

    @property
    def operator(self) -> LaplaceSystem:
        """L, or the variant whose rows the prior has."""
        laplace = self.few.system.laplace
        assert isinstance(laplace, LaplaceSystem)
        return laplace

    @property
    def given(self) -> Array:
        """Values that are given, zero elsewhere, shape (V,)."""
        return np.where(self.moving, 0.0, self.few.b)


def wide_terms(program: Program, few_rows: int = FEW_ROWS) -> list[ProgramTerm]:
    """Terms with many rows, other than the Laplace term and measurements."""
    prior = program.laplace_prior
    return [
        t
        for t in program.terms
        if t is not prior and not t.is_measured and len(t.target) > few_rows
    ]


def _over(term: ProgramTerm, weight: float, V: int) -> ProgramTerm:
    """The columns of the field, the weight over the prior's."""
    own = term.matrix if term.matrix.shape[1] == V else term.matrix[:, :V]
    return replace(term, weight=term.weight / weight, matrix=sp.csr_array(own))
