"""A cone solver reached through cvxpy: takes every penalty, one that bends included.

The problem is said to cvxpy row by row as the program has it, each constraint by its
name, so that its multipliers come back by name. cvxpy's convention is ours: the dual
of g(x) ≤ 0 is not negative and pulls back.
"""

from __future__ import annotations

import abc
import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array
from ttus_opt.problem.kkt import Duals
from ttus_opt.problem.members import QUADRATIC, ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Claim, Prepared, Request, Solver
from ttus_opt.solvers.verified import Verified
from ttus_opt.terms.base import Penalty


class CvxpySolver(Solver):
    """One of cvxpy's cone solvers."""

    #: Its name in cvxpy
    backend: str
    #: First tolerance handed to the package, as a part of the one asked for
    margin: float = 0.1

    @abc.abstractmethod
    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """A tolerance and a time limit in the package's own words.

        Args:
            eps: Its own relative tolerance [–].
            seconds: Most time it may take; None for no limit [s].

        Returns:
            Keywords of ``cvxpy.Problem.solve``.
        """

    def prepare(self, program: Program, request: Request) -> Prepared:
        """Say the program to cvxpy."""
        self.require(program)
        return _Loaded(self, program, request)


@dataclass
class _Sided:
    """The cvxpy constraints that one set of two-sided rows became."""

    size: int
    equal: NDArray[np.bool_]
    above: NDArray[np.bool_]
    below: NDArray[np.bool_]
    said: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def say(cls, value: Any, lower: Array, upper: Array) -> _Sided:
        equal = lower == upper
        above = ~equal & np.isfinite(upper)
        below = ~equal & np.isfinite(lower)
        rows = cls(len(lower), equal, above, below)
        for name, mask in (("equal", equal), ("above", above), ("below", below)):
            picked = np.flatnonzero(mask)
            if not len(picked):
                continue
            part = value[picked]
            if name == "equal":
                rows.said[name] = part == lower[picked]
            elif name == "above":
                rows.said[name] = part <= upper[picked]
            else:
                rows.said[name] = part >= lower[picked]
        return rows

    def dual(self) -> Array:
        y = np.zeros(self.size)
        for name, sign in (("equal", 1.0), ("above", 1.0), ("below", -1.0)):
            if name in self.said and self.said[name].dual_value is not None:
                y[getattr(self, name)] += sign * self.said[name].dual_value
        return y


class _Loaded(Verified):
    """A program in cvxpy's terms; nothing is kept between solves."""

    def __init__(self, solver: CvxpySolver, program: Program, request: Request) -> None:
        self._solver = solver
        self.margin = solver.margin
        super().__init__(program, request)

    def _load(self, program: Program) -> None:
        import cvxpy as cp

        self._x = cp.Variable(program.n_variables)
        said: list[Any] = []
        cost: Any = 0.0
        self._terms = {}
        for term in program.terms:
            if term.weight == 0.0:
                continue
            residual = term.matrix @ self._x - term.target
            if term.penalty not in QUADRATIC:
                # a name for the residual gives it a multiplier, w times a subgradient
                named = cp.Variable(len(term.target))
                self._terms[term.name] = (term, residual == named)
                said.append(self._terms[term.name][1])
                residual = named
            cost += _cost(term, residual)
        self._rows = {
            c.name: _Sided.say(c.matrix @ self._x, c.lower, c.upper)
            for c in program.constraints
        }
        self._box = _Sided.say(self._x, *program.box) if program.bounds else None
        said += [s for rows in self._rows.values() for s in rows.said.values()]
        if self._box is not None:
            said += list(self._box.said.values())
        self._problem = cp.Problem(cp.Minimize(cost), said)

    def _attempt(self, eps: float, seconds: float | None) -> Candidate:
        import cvxpy as cp

        with warnings.catch_warnings():
            # "solution may be inaccurate": checked here in any case
            warnings.simplefilter("ignore")
            try:
                self._problem.solve(
                    solver=self._solver.backend, **self._solver.options(eps, seconds)
                )
            except cp.error.SolverError as error:
                said = f"{type(error).__name__}: {error}"
                return Candidate(None, claim=Claim.GAVE_UP, detail=said)
        words = str(self._problem.status)
        claim = _CLAIMS.get(words, Claim.GAVE_UP)
        if self._x.value is None or not np.isfinite(self._x.value).all():
            return Candidate(
                None, claim=_CLAIMS.get(words, Claim.GAVE_UP), detail=words
            )
        stats = self._problem.solver_stats
        duals = Duals(
            {name: rows.dual() for name, rows in self._rows.items()},
            None if self._box is None else self._box.dual(),
            {
                name: term.admissible(row.dual_value / term.weight)
                for name, (term, row) in self._terms.items()
                if row.dual_value is not None
            },
        )
        return Candidate(
            np.array(self._x.value),
            duals,
            int(stats.num_iters or 0) if stats is not None else 0,
            claim,
            words,
        )


_CLAIMS = {
    "optimal": Claim.DONE,
    "infeasible": Claim.INFEASIBLE,
    "optimal_inaccurate": Claim.DOUBTS,
    "unbounded": Claim.UNBOUNDED,
    "user_limit": Claim.TIME_LIMIT,
}


def _cost(term: ProgramTerm, residual: Any) -> Any:
    """The weighted penalty in cvxpy's words."""
    import cvxpy as cp

    if term.penalty is Penalty.SQUARES:
        return term.weight * cp.sum_squares(residual)
    if term.penalty is Penalty.HUBER:
        return term.weight * cp.sum(cp.huber(residual, term.threshold))
    if term.penalty is Penalty.LINEAR:
        return term.weight * cp.sum(residual)
    if term.penalty is Penalty.GROUPS:
        shape = (len(term.target) // term.group_size, term.group_size)
        groups = cp.reshape(residual, shape, order="C")
        return term.weight * cp.sum(cp.norm(groups, 2, axis=1))
    return term.weight * cp.norm1(residual)
