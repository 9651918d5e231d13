"""A program as a cvxpy problem, for its cone solvers and for further use.

Constraints keep their rows and names, so that multipliers are returned by name. For
linear rows cvxpy has our sign: the dual of g(x) ≤ 0 is not negative. For a cone s ∈ K
it returns λ ∈ K; ours is −λ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.problem.members import ProgramCones, ProgramTerm, Sides
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.kkt import Duals


@dataclass(frozen=True)
class CvxpyProgram:
    """A cvxpy problem with its variables and constraints by name.

    Attributes:
        problem: The ``cvxpy.Problem``.
        variables: A ``cvxpy.Variable`` per variable of the program.
        constraints: Its constraints, under the program's names. All bounds together are
            called ``bounds``; the equations that define the residual of a penalty that
            is not quadratic have the name of its term.
    """

    problem: Any
    variables: Mapping[str, Any]
    constraints: Mapping[str, list[Any]]
    _rows: Mapping[str, _TwoSided | _Cones] = field(repr=False)
    _box: _TwoSided | None = field(repr=False)
    _nonquadratic: Mapping[str, tuple[ProgramTerm, Any]] = field(repr=False)

    @classmethod
    def of(cls, program: Program) -> CvxpyProgram:
        """State a program in cvxpy.

        Args:
            program: Any program; a term of weight 0 is left out.
        """
        import cvxpy as cp

        variables = {
            name: cp.Variable(part.stop - part.start, name=name)
            for name, part in program.variables.items()
        }
        x = next(iter(variables.values()))
        if len(variables) > 1:
            x = cp.hstack(list(variables.values()))
        cost, nonquadratic = cp.Constant(0.0), {}
        for term in program.terms:
            if term.weight == 0.0:
                continue
            residual = term.matrix @ x - term.target
            if not term.penalty.quadratic:
                # as a variable, the residual has a multiplier, w times a subgradient
                lifted = cp.Variable(len(term.target))
                nonquadratic[term.name] = term, residual == lifted
                residual = lifted
            cost += term.weight * term.penalty.in_cvxpy(residual, cp)
        rows: dict[str, _TwoSided | _Cones] = {
            c.name: _TwoSided.of(c.matrix @ x, c.lower, c.upper)
            for c in program.constraints
        }
        rows |= {c.name: _Cones.of(c.matrix @ x + c.offset, c) for c in program.cones}
        box = _TwoSided.of(x, *program.box) if program.bounds else None
        stated = {name: list(member.stated.values()) for name, member in rows.items()}
        if box is not None:
            stated["bounds"] = list(box.stated.values())
        stated |= {name: [row] for name, (_, row) in nonquadratic.items()}
        problem = cp.Problem(
            cp.Minimize(cost), [part for parts in stated.values() for part in parts]
        )
        return cls(problem, variables, stated, rows, box, nonquadratic)

    def point(self) -> Array | None:
        """Current values of all variables, shape (n,); None without them."""
        values = [variable.value for variable in self.variables.values()]
        if any(v is None or not np.isfinite(v).all() for v in values):
            return None
        return np.concatenate(values)

    def duals(self) -> Duals:
        """Current multipliers, by the program's names."""
        return Duals(
            {name: rows.dual() for name, rows in self._rows.items()},
            None if self._box is None else self._box.dual(),
            {
                name: term.penalty.admissible(row.dual_value / term.weight)
                for name, (term, row) in self._nonquadratic.items()
                if row.dual_value is not None
            },
        )


@dataclass(frozen=True)
class _TwoSided:
    """The cvxpy constraints of one set of rows between limits."""

    sides: Sides
    stated: Mapping[str, Any]

    @classmethod
    def of(cls, value: Any, lower: Array, upper: Array) -> _TwoSided:
        sides, stated = Sides(lower, upper), {}
        if len(at := np.flatnonzero(sides.equal)):
            stated["equal"] = value[at] == lower[at]
        if len(at := np.flatnonzero(sides.above)):
            stated["above"] = value[at] <= upper[at]
        if len(at := np.flatnonzero(sides.below)):
            stated["below"] = value[at] >= lower[at]
        return cls(sides, stated)

    def dual(self) -> Array:
        y = np.zeros(len(self.sides.lower))
        for name, stated in self.stated.items():
            if stated.dual_value is not None:
                sign = -1.0 if name == "below" else 1.0
                y[getattr(self.sides, name)] += sign * stated.dual_value
        return y


@dataclass(frozen=True)
class _Cones:
    """The cvxpy constraints of one set of second-order cones, one for each size."""

    size: int
    rows: Mapping[int, IntArray]
    stated: Mapping[int, Any]

    @classmethod
    def of(cls, value: Any, cones: ProgramCones) -> _Cones:
        import cvxpy as cp

        sizes = np.asarray(cones.sizes)
        rows, stated = {}, {}
        for size in np.unique(sizes).tolist():
            at = cones.first[sizes == size][:, None] + np.arange(size)
            rows[size] = at
            if size == 1:
                stated[size] = value[at[:, 0]] >= 0.0
                continue
            shape = (len(at), size - 1)
            tails = cp.reshape(value[at[:, 1:].reshape(-1)], shape, order="C")
            stated[size] = cp.SOC(value[at[:, 0]], tails, axis=1)
        return cls(len(cones.offset), rows, stated)

    def dual(self) -> Array:
        y = np.zeros(self.size)
        for size, stated in self.stated.items():
            given = stated.dual_value
            if given is None or (size > 1 and any(part is None for part in given)):
                continue
            at = self.rows[size]
            if size == 1:
                y[at[:, 0]] = -np.asarray(given)
                continue
            head, tails = given
            y[at[:, 0]] = -np.asarray(head).reshape(-1)
            y[at[:, 1:]] = -np.asarray(tails).reshape(len(at), size - 1)
        return y
