"""The verdict on a solver's candidate, by its residuals and certificates.

A solver whose arithmetic breaks down has no answer, and the fit itself does not fail
(`Guarded`). Badly scaled problems make factorisations fail or iterations diverge.
``solver="auto"`` then continues with the next solver. A user's solver cannot write to
the program's arrays, which are those of the scene and of the verdict after the solve.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.core.plugins import user_errors
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import Reduction
from ttus_opt.problem.solution import Solution, Status, Timings
from ttus_opt.problem.verify.certificate import conflicting, falling_ray
from ttus_opt.problem.verify.kkt import KKT, Duals, kkt_residuals
from ttus_opt.solvers.base import Candidate, Claim, Prepared, Request, Solver
from ttus_opt.voxmap.field import PotentialField

T = TypeVar("T")

#: Exceptions of arithmetic; from a user's own solver they become an `InputError`
BREAKDOWNS = (ArithmeticError, np.linalg.LinAlgError)


class Guarded(Prepared):
    """A solver with a program loaded, whose breakdowns become candidates without x.

    Args:
        solver: The solver.
        program: The program to load.
        request: Tolerance and time limit.
    """

    def __init__(self, solver: Solver, program: Program, request: Request) -> None:
        """Load the program.

        Raises:
            InputError: The solver cannot take it.
            SolverUnavailableError: The solver's package is not installed.
        """
        self._solver, self._request = solver, request
        self._is_ours = type(solver).__module__.startswith("ttus_opt.")
        self._prepared: Prepared | None = None
        self._why = ""
        self.update(program)

    def update(self, program: Program) -> None:
        """Load other data; after a breakdown, prepare the solver again."""
        kept, self._prepared = self._prepared, None
        self._program = program

        def load() -> Prepared:
            if kept is None:
                return self._solver.prepare(program, self._request)
            kept.update(program)
            return kept

        self._prepared = self._tried(load)

    def solve(self) -> Candidate:
        """The solver's answer, or a candidate with the reason."""
        candidate = None
        if self._prepared is not None:
            candidate = self._tried(self._prepared.solve)
        if candidate is None:
            return Candidate(None, claim=Claim.GAVE_UP, detail=self._why)
        return candidate

    def _tried(self, act: Callable[[], T]) -> T | None:
        """The result of a call; None if it broke down."""
        try:
            with contextlib.ExitStack() as stack:
                stack.enter_context(user_errors(f"solver {self._solver.name}"))
                if not self._is_ours:
                    stack.enter_context(locked(self._program))
                return act()
        except BREAKDOWNS as error:
            self._why = f"{type(error).__name__}: {error}"
            return None


@contextlib.contextmanager
def locked(thing: Any) -> Iterator[None]:
    """Make all arrays of a dataclass, in members too, read-only within the block."""
    written = [array for array in _arrays(thing, set()) if array.flags.writeable]
    try:
        for array in written:
            array.flags.writeable = False
        yield
    finally:
        for array in reversed(written):
            array.flags.writeable = True


def _arrays(thing: Any, seen: set[int]) -> Iterator[Array]:
    """Arrays of a thing, of its fields and of what it has cached, once each."""
    if id(thing) in seen:
        return
    seen.add(id(thing))
    parts: Any = ()
    if isinstance(thing, np.ndarray):
        yield thing
    elif sp.issparse(thing):
        own = vars(thing)
        parts = (own.get("data"), own.get("indices"), own.get("indptr"))
        parts += tuple(own.get("coords") or ())
    elif dataclasses.is_dataclass(thing):
        parts = tuple(vars(thing).values())
    elif isinstance(thing, Mapping):
        parts = tuple(thing.values())
    elif isinstance(thing, tuple | list | frozenset):
        parts = thing
    for part in parts:
        yield from _arrays(part, seen)


#: Seconds spent on naming the constraints in conflict, when no limit is given
CONFLICT_SECONDS = 30.0


def checked_candidate(answer: Candidate, program: Program, solver: str) -> Candidate:
    """A solver's candidate with vectors of its own, as it may be a user's.

    Raises:
        InputError: It is not a `Candidate`, or one of its fields is not what it must
            be.
    """

    def check(value: Any, kind: Any, words: str, what: str = "") -> None:
        if not isinstance(value, kind):
            begin = f"its {what} must be" if what else "solve() must return"
            raise InputError(
                f"solver {solver}: {begin} {words}, got {type(value).__name__}"
            )

    check(answer, Candidate, "a Candidate")
    check(answer.duals, Duals, "Duals", "duals")
    check(answer.claim, Claim, "a Claim", "claim")
    check(answer.detail, str, "a text", "detail")
    check(answer.iterations, int | np.integer, "a whole number", "iterations")
    check(answer.duals.rows, Mapping, "vectors by constraint", "duals.rows")
    check(answer.duals.terms, Mapping, "vectors by term", "duals.terms")
    n, duals = program.n_variables, answer.duals
    sizes = {c.name: len(c.lower) for c in program.constraints}
    sizes |= {c.name: len(c.offset) for c in program.cones}

    def own(name: str, vector: Any, size: int | None) -> Array:
        """A copy of a vector.

        Raises:
            InputError: It is not a vector of real numbers, or of another length.
        """
        plain = type(vector) is np.ndarray and vector.dtype.kind in "fiu"
        if not plain or vector.ndim != 1 or len(vector) != (size or len(vector)):
            given = getattr(vector, "dtype", None)
            kind = type(vector).__name__ + (f" of {given}" if given is not None else "")
            wanted = "(m,)" if size is None else f"({size},)"
            raise InputError(
                f"solver {solver}: its {name} must be an array of real numbers of "
                f"shape {wanted}, got {kind} of shape {np.shape(vector)}"
            )
        return np.array(vector, dtype=np.float64)

    def own_all(name: str, vectors: Mapping[str, Array]) -> dict[str, Array]:
        return {k: own(f"{name}[{k!r}]", v, sizes.get(k)) for k, v in vectors.items()}

    x, bounds = answer.x, duals.bounds
    return replace(
        answer,
        x=None if x is None else own("x", x, n),
        duals=Duals(
            own_all("duals.rows", duals.rows),
            None if bounds is None else own("duals.bounds", bounds, n),
            own_all("duals.terms", duals.terms),
        ),
    )


def judged(
    declared: Formulation,
    reduction: Reduction,
    solver: str,
    candidate: Candidate,
    request: Request,
    timings: Timings,
) -> Solution:
    """Turn a candidate into a solution by its own residuals.

    Args:
        declared: The formulation.
        reduction: Its program, and the solver's.
        solver: The solver's name.
        candidate: The solver's answer.
        request: Tolerance and time limit.
        timings: Timings of the fit so far.

    Returns:
        The solution of the original program.
    """
    program, x, duals = reduction.original, candidate.x, candidate.duals
    parameters, scene = dict(declared.scene_parameters), declared.scene
    kkt, field = None, None
    costs: dict[str, float] = {}
    slacks: dict[str, Array] = {}
    if x is not None:
        point = reduction.restore(x, duals)
        x, duals = point.x, point.duals
        kkt = kkt_residuals(program, x, duals, tolerance=request.tolerance)
        with np.errstate(over="ignore", invalid="ignore"):  # x may be huge
            costs = program.costs(x)
        limited = (*program.limited_rows, *program.bounds)
        slacks = {member.name: member.slack(x) for member in limited}
        if np.isfinite(x).all():
            parameters = declared.parameters(program.split(x))
    verdict = _verdict(candidate, reduction, kkt, request)
    if verdict.status is Status.SOLVED and x is not None:
        field = PotentialField(
            scene.voxmap,
            scene.voxmap.grid.unflatten(x[program.variables["p"]]).copy(),
            scene.sampling,
            parameters,
            {"formulation": str(declared), "solver": solver},
        )
    return Solution(
        status=verdict.status,
        solver=solver,
        formulation=declared.name,
        kkt=kkt,
        objective=float("nan") if not costs else sum(costs.values()),
        costs=costs,
        slacks=slacks,
        duals=duals,
        timings=timings,
        iterations=candidate.iterations,
        parameters=parameters,
        program=program,
        candidate=x,
        detail="; ".join(filter(None, (candidate.detail, verdict.remark))),
        verified_field=field,
        conflict=verdict.conflict,
    )


@dataclass(frozen=True)
class _Verdict:
    """A status, the constraints in conflict, and a remark on the solver's claim."""

    status: Status
    conflict: tuple[str, ...] = ()
    remark: str = ""


def _verdict(
    candidate: Candidate, reduction: Reduction, kkt: KKT | None, request: Request
) -> _Verdict:
    """The status by residuals and certificates, not by the solver's claim."""
    claim, seconds = candidate.claim, request.time_limit or CONFLICT_SECONDS
    holds = kkt is not None and kkt.worst_relative <= request.tolerance
    if kkt is not None and holds and kkt.is_bound:
        return _Verdict(Status.SOLVED)
    broken = kkt is None or kkt.primal_relative > request.tolerance
    if claim is Claim.INFEASIBLE or (claim is not Claim.TIME_LIMIT and broken):
        claimed = candidate.duals if candidate.x is None else None
        conflict = conflicting(reduction.original, claimed=claimed, time_limit=seconds)
        if conflict:
            return _Verdict(Status.INFEASIBLE, conflict)
    ours = reduction.program
    if claim is Claim.UNBOUNDED and falling_ray(ours, time_limit=seconds) is not None:
        return _Verdict(Status.UNBOUNDED)
    if claim is Claim.TIME_LIMIT:
        return _Verdict(Status.TIME_LIMIT)
    remark = ""
    if claim in (Claim.INFEASIBLE, Claim.UNBOUNDED):
        remark = f'"{claim.value}" is the solver\'s word, without a proof that holds'
    elif holds:
        remark = "the residuals hold, but nothing bounds the gap to the optimum"
    return _Verdict(Status.FAILED if kkt is None else Status.INACCURATE, (), remark)
