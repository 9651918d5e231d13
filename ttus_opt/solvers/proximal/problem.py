"""A program as rows under penalties or between limits, and given values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.rows import unit_rows
from ttus_opt.problem.terms.structure import LaplaceRows
from ttus_opt.problem.verify.distance import held_by_equalities
from ttus_opt.problem.verify.kkt import Duals
from ttus_opt.solvers.proximal.penalised_rows import Anchor, Between, PenalisedRows

#: Most rows beside Laplace's, over the voxels, that are few [–]
FEW = 0.1

#: Name of the rows that stand for the box; no constraint is called so
BOX = "box of all bounds"


@dataclass(frozen=True)
class PenalisedProblem:
    """A program, sorted.

    Attributes:
        program: As it was declared.
        blocks: Terms with a weight, rows between limits, the box, the proximal term.
        fixed: Variables whose values are given, shape (n,).
        values: Those values, zero elsewhere, shape (n,).
        given: By constraint, which of its rows give values.
    """

    program: Program
    blocks: tuple[PenalisedRows, ...] = field(repr=False)
    fixed: Mask = field(repr=False)
    values: Array = field(repr=False)
    given: Mapping[str, Mask] = field(repr=False)

    @classmethod
    def of(cls, program: Program) -> PenalisedProblem:
        """Sort a program without cones."""
        fixed = held_by_equalities(program)
        values = np.zeros(program.n_variables)
        blocks = [PenalisedRows.of(t) for t in program.terms if t.weight > 0.0]
        given = {}
        for constraint in program.constraints:
            own = given[constraint.name] = constraint.fixing
            rows = constraint.matrix[own]
            values[rows.indices] = constraint.lower[own] / rows.data
            if not own.all():
                left = constraint.matrix[~own]
                law = Between(constraint.lower[~own], constraint.upper[~own])
                blocks.append(_limits(constraint.name, left, law))
        if program.bounds:
            lower, upper = program.box
            held = (np.isfinite(lower) | np.isfinite(upper)) & ~fixed
            at = np.flatnonzero(held)
            if len(at):
                law = Between(lower[at], upper[at])
                blocks.append(_limits(BOX, unit_rows(at, len(fixed)), law))
        return cls(program, tuple(blocks), fixed, values, given)

    def anchored(
        self, rows: sp.csr_array, laplace: LaplaceRows | None = None
    ) -> PenalisedProblem:
        """With a proximal term of some rows, which may be Laplace's."""
        return replace(self, blocks=(*self.blocks, Anchor(rows, laplace)))

    @property
    def anchor(self) -> Anchor | None:
        """The proximal term; None without one."""
        return next((b for b in self.blocks if isinstance(b, Anchor)), None)

    @property
    def bent(self) -> list[PenalisedRows]:
        """Blocks that are not smooth, whose multipliers are estimated."""
        return [rows for rows in self.blocks if not rows.exact]

    @property
    def held_by_laplace(self) -> bool:
        """Whether squares of Laplace's rows determine the field."""
        prior = self.program.laplace_prior
        if prior is None or prior.weight == 0.0:
            return False
        rows = prior.laplace_rows
        fixed, free = self.fixed[self.program.variables["p"]], self.program.laplace.free
        return rows is not None and (rows.scale is None or bool(fixed[~free].all()))

    @property
    def few_beside_laplace(self) -> bool:
        """Whether all rows but a few are Laplace's, and over p alone."""
        program, own = self.program, [b for b in self.blocks if b.laplace is not None]
        if set(program.variables) != {"p"} or program.laplace is None or not own:
            return False
        few = sum(len(b.target) for b in self.blocks if b.laplace is None)
        given = bool(np.array_equal(self.fixed, ~program.laplace.free))
        soft = self.held_by_laplace and not self.fixed.any()
        plain = all(getattr(b.law, "rows_per_group", 1) == 1 for b in own)
        return plain and (given or soft) and few <= FEW * len(self.fixed)

    def duals(self, multipliers: list[Array], gradient: Array) -> Duals:
        """Multipliers by name.

        Args:
            multipliers: Multipliers of every block.
            gradient: Gradient of the Lagrangian, cancelled by given values, (n,).
        """
        program = self.program
        pairs = zip(self.blocks, multipliers, strict=True)
        by_name = {b.name: y for b, y in pairs if b is not self.anchor}
        terms = {
            t.name: by_name[t.name] / t.weight
            for t in program.terms
            if t.weight > 0.0 and not t.penalty.quadratic
        }
        rows, left = {}, np.where(self.fixed, -gradient, 0.0)
        for constraint in program.constraints:
            own = self.given[constraint.name]
            y = np.zeros(len(own))
            if own.any():
                matrix = constraint.matrix[own]
                y[own] = left[matrix.indices] / matrix.data
                left[matrix.indices] = 0.0
            if not own.all():
                y[~own] = by_name[constraint.name]
            rows[constraint.name] = y
        bounds = None
        if program.bounds:
            bounds = np.zeros(program.n_variables)
            if BOX in by_name:
                box = next(b for b in self.blocks if b.name == BOX)
                bounds[box.matrix.indices] = by_name[BOX]
        return Duals(rows, bounds, terms)


def _limits(name: str, matrix: sp.csr_array, law: Between) -> PenalisedRows:
    return PenalisedRows(name, matrix, np.zeros(matrix.shape[0]), 1.0, law)
