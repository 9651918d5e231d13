"""A solution: a verified field, or a status that says what to do next."""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import TtusError
from ttus_opt.core.html_card import page, table
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.kkt import KKT, Duals, bound_duals
from ttus_opt.voxmap.field import PotentialField

#: Least active multiplier over the largest of its member [–]
NEGLIGIBLE = 1e-6


class Status(enum.Enum):
    """Outcome of a solve; the value is advice."""

    SOLVED = "the optimality conditions hold to the requested tolerance"
    INACCURATE = (
        "the answer fails verification: loosen the tolerance, allow more iterations "
        "or use another solver"
    )
    INFEASIBLE = "the constraints contradict each other: drop or soften one"
    UNBOUNDED = "the objective has no minimum: add a term that bounds every variable"
    TIME_LIMIT = "the time limit was reached: allow more time or use a faster solver"
    FAILED = "the solver gave up: use another solver"


@dataclass(frozen=True)
class Timings:
    """Times of a fit; those other than ``compile`` exclude numba's compilation.

    Attributes:
        assembly: Scene and program [s].
        setup: The solver's preparation (factorisation, scaling) [s].
        solve: The first solve after it [s].
        again: The latest solve with other data, including its update; None without
            one [s].
        search: Choice of weights, fits of a search, and fits for standard errors; None
            without any [s].
        compile: Compilation, once on every machine [s].
    """

    assembly: float
    setup: float
    solve: float
    again: float | None = None
    search: float | None = None
    compile: float = 0.0

    def as_dict(self) -> dict[str, float]:
        """All times that were measured, by name, for JSON."""
        return {name: v for name, v in asdict(self).items() if v is not None}


@dataclass(frozen=True)
class Attempt:
    """A solver that "auto" tried before the one that answered.

    Attributes:
        solver: Its name.
        status: Its status.
        residual: Its largest relative KKT residual; None without a candidate [–].
        detail: The solver's own message.
    """

    solver: str
    status: Status
    residual: float | None
    detail: str

    @classmethod
    def of(cls, solution: Solution) -> Attempt:
        """From a solution that failed its check."""
        kkt = solution.kkt
        residual = None if kkt is None else kkt.worst_relative
        return cls(solution.solver, solution.status, residual, solution.detail)

    def __str__(self) -> str:
        """In one phrase."""
        residual = "" if self.residual is None else f" at {self.residual:.1e}"
        return f"{self.solver} {self.status.name.lower()}{residual}"


class NoSolutionError(TtusError, RuntimeError):
    """There is no verified solution; carries the result.

    Attributes:
        solution: Status, program, candidate and residuals.
    """

    def __init__(self, message: str, solution: Solution) -> None:
        super().__init__(message)
        self.solution = solution


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of a fit.

    Attributes:
        status: By the residuals computed here.
        solver: Name of the solver.
        formulation: Name of the formulation.
        kkt: Residuals of the optimality conditions; None without a candidate.
        objective: Value at the candidate.
        costs: Weighted cost per term, by name.
        slacks: Distance to the nearer limit per constraint row, by name.
        duals: Multipliers of the KKT conditions; by name in `duals_by_name`.
        timings: Times of the fit.
        iterations: Iterations of the solver's main loop [–].
        parameters: Parameters identified beside the field, by name.
        program: The matrices.
        candidate: The solver's x, verified or not; None without one.
        detail: The solver's own message.
        conflict: Names of the constraints that contradict each other, when infeasible.
        attempts: Solvers that "auto" tried before, whose answers failed their check.
        standard_errors: Standard errors of the parameters, by name [their units].
        not_identified: Why the data do not determine a parameter, whose neutral value
            is used, by name.
        remarks: Further remarks on parameters, by name, such as being at a limit or
            having no standard error.
        compressed: Rows of terms before and after compression, by name
            (`ttus_opt.problem.compression`).
        chosen: How weights and formulation were chosen from the recordings, in words;
            empty where they were not.
    """

    status: Status
    solver: str
    formulation: str
    kkt: KKT | None
    objective: float
    costs: Mapping[str, float]
    slacks: Mapping[str, Array] = field(repr=False)
    duals: Duals = field(repr=False)
    timings: Timings
    iterations: int
    parameters: Mapping[str, float]
    program: Program = field(repr=False)
    candidate: Array | None = field(repr=False)
    detail: str = field(default="", repr=False)
    verified_field: PotentialField | None = field(default=None, repr=False)
    conflict: tuple[str, ...] = ()
    attempts: tuple[Attempt, ...] = ()
    standard_errors: Mapping[str, float] = field(default_factory=dict)
    not_identified: Mapping[str, str] = field(default_factory=dict)
    remarks: Mapping[str, str] = field(default_factory=dict)
    compressed: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    chosen: tuple[str, ...] = ()

    @property
    def field(self) -> PotentialField:
        """The fitted field.

        Raises:
            NoSolutionError: There is no verified one.
        """
        if self.verified_field is None:
            raise NoSolutionError(self.advice, self)
        return self.verified_field

    @property
    def advice(self) -> str:
        """Outcome and advice in one line."""
        residual = "" if self.kkt is None else f", KKT {self.kkt.worst_relative:.1e}"
        between = f" ({' against '.join(self.conflict)})" if self.conflict else ""
        after = (
            f" (after {', '.join(map(str, self.attempts))})" if self.attempts else ""
        )
        return (
            f"{self.solver}{after} on {self.formulation}: {self.status.name.lower()}"
            f"{residual}{between}: {self.status.value}"
        )

    @property
    def identified(self) -> tuple[str, ...]:
        """The identified parameters, a line each."""
        return tuple(self._line(name, value) for name, value in self.parameters.items())

    def _line(self, name: str, value: float) -> str:
        if name in self.not_identified:
            return (
                f"{name}: not identified ({self.not_identified[name]}): "
                f"{value:.4g} is used"
            )
        error = self.standard_errors.get(name)
        line = f"{name} {value:.4g}"
        if error is not None:
            # two digits of the error, and the value to the same place
            place = 6 if error == 0.0 else 1 - math.floor(math.log10(error))
            digits = min(max(place, 0), 12)
            line = f"{name} {value:.{digits}f} ± {error:.{digits}f}"
        remark = self.remarks.get(name)
        return f"{line} ({remark})" if remark else line

    @property
    def weights(self) -> Mapping[str, float]:
        """Weight of every term, by name."""
        return {term.name: term.weight for term in self.program.terms}

    @property
    def n_voxels(self) -> int:
        """Number of values of the potential V [–]."""
        p = self.program.variables["p"]
        return int(p.stop - p.start)

    @property
    def variables(self) -> Mapping[str, Array]:
        """The candidate's variables by name, verified or not; empty without one."""
        return {} if self.candidate is None else self.program.split(self.candidate)

    def as_dict(self) -> dict[str, Any]:
        """What the fit found, by name, for JSON."""
        attempts = [
            {**asdict(each), "status": each.status.name.lower()}
            for each in self.attempts
        ]
        return {
            "status": self.status.name.lower(),
            "advice": "" if self.verified_field is not None else self.status.value,
            "formulation": self.formulation,
            "solver": self.solver,
            "detail": self.detail,
            "attempts": attempts,
            "voxels": self.n_voxels,
            "objective": self.objective,
            "costs": dict(self.costs),
            "weights": dict(self.weights),
            "kkt": None if self.kkt is None else self.kkt.as_dict(),
            "iterations": self.iterations,
            "parameters": dict(self.parameters),
            "standard_errors": dict(self.standard_errors),
            "not_identified": dict(self.not_identified),
            "compressed": dict(self.compressed),
            "remarks": dict(self.remarks),
            "seconds": self.timings.as_dict(),
        }

    def summary(self) -> str:
        """Outcome, costs and active limits as plain text."""
        lines = [self._verdict, f"  {self.status.value}", f"  {self._effort}"]
        lines += [f"  {name}: cost {cost:.4g}" for name, cost in self.costs.items()]
        lines += [f"  {name}: {active}" for name, active in self._active_limits()]
        lines += [f"  {line}" for line in (*self.identified, *self.chosen)]
        return "\n".join(lines)

    def __repr__(self) -> str:
        """The verdict in one line; `summary` says more."""
        return f"<Solution {self._verdict}>"

    def _repr_html_(self) -> str:
        """The summary as a table, for notebooks."""
        rows = [["term", name, f"cost {cost:.4g}"] for name, cost in self.costs.items()]
        rows += [["limits", name, active] for name, active in self._active_limits()]
        lines = [self.status.value, self._effort, *self.identified, *self.chosen]
        return page(self._verdict, lines, table(["", "name", ""], rows))

    @property
    def _verdict(self) -> str:
        """Formulation, solver, status and residual in one line."""
        residual = "" if self.kkt is None else f", KKT {self.kkt.worst_relative:.1e}"
        objective = "" if not self.costs else f", objective {self.objective:.6g}"
        status = self.status.name.lower().replace("_", " ")
        return f"{self.formulation} by {self.solver}: {status}{residual}{objective}"

    @property
    def _effort(self) -> str:
        """Size, iterations and time."""
        times = self.timings
        return (
            f"{self.program.sizes}; {self.iterations:,} iterations, "
            f"{times.setup + times.solve:.2g} s"
        )

    def _active_limits(self) -> Iterator[tuple[str, str]]:
        """Name of every constraint, and the number of its active rows in words."""
        duals = self.duals_by_name
        cones = {cone.name: cone.first for cone in self.program.cones}
        for name, slack in self.slacks.items():
            y = np.abs(duals.get(name, np.zeros(0)))
            if name in cones and len(y):  # a cone has one multiplier, of several rows
                y = np.maximum.reduceat(y, cones[name])
            largest = float(y.max(initial=0.0))
            active = int((y > NEGLIGIBLE * largest).sum()) if largest else 0
            count = int((slack < np.inf).sum())
            yield name, f"{active:,} of {count:,} active, multipliers to {largest:.3g}"

    @property
    def duals_by_name(self) -> Mapping[str, Array]:
        """Multipliers of every constraint and every bound, by name.

        Positive at active upper limits, negative at lower ones.
        """
        return dict(self.duals.rows) | bound_duals(self.program, self.duals.bounds)
