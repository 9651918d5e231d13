"""A sparse QP package reached through qpsolvers: one class, a file per package.

Every package gets the least-squares form, which has equality rows: without any,
qpsolvers sends several packages through LSQR, where a false "unbounded below" is
possible. qpsolvers does not see ``csc_array`` as sparse: it is handed
``csc_matrix``. Its duals carry our signs already (`ttus_opt.solvers.quadratic`).
"""

from __future__ import annotations

import abc
import warnings
from typing import Any

import numpy as np

from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Claim, Prepared, Request, Solver
from ttus_opt.solvers.quadratic import OneSided, read_back
from ttus_opt.solvers.verified import Verified


class QpsolversSolver(Solver):
    """One of qpsolvers' packages; its name is ours."""

    #: First tolerance handed to the package, as a part of the one asked for
    margin: float = 1.0

    @abc.abstractmethod
    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """A tolerance and a time limit in the package's own words.

        Args:
            eps: Its own relative tolerance [–].
            seconds: Most time it may take; None for no limit [s].

        Returns:
            Keywords of ``qpsolvers.solve_problem``.
        """

    def prepare(self, program: Program, request: Request) -> Prepared:
        """Bring the program into the package's form."""
        self.require(program)
        return _Loaded(self, program, request)


class _Loaded(Verified):
    """A program in qpsolvers' terms; nothing is kept between solves."""

    def __init__(
        self, solver: QpsolversSolver, program: Program, request: Request
    ) -> None:
        self._solver = solver
        self.margin = solver.margin
        super().__init__(program, request)

    def _load(self, program: Program) -> None:
        self._form = program.least_squares_qp()
        self._split = OneSided.of(self._form)

    def _attempt(self, eps: float, seconds: float | None) -> Candidate:
        import qpsolvers

        s = self._split
        some = len(s.h) > 0
        problem = qpsolvers.Problem(
            s.P,
            s.q,
            s.G if some else None,
            s.h if some else None,
            s.A,
            s.b,
            s.lb if s.boxed else None,
            s.ub if s.boxed else None,
        )
        with warnings.catch_warnings():
            # about the package's own defaults and status; the answer is checked here
            warnings.simplefilter("ignore")
            try:
                answer = qpsolvers.solve_problem(
                    problem,
                    solver=self._solver.name,
                    **self._solver.options(eps, seconds),
                )
            except (qpsolvers.SolverError, ValueError, RuntimeError) as error:
                said = f"{type(error).__name__}: {error}"
                return Candidate(None, claim=Claim.GAVE_UP, detail=said)
        words, iterations = _own_words(answer.extras or {})
        return read_back(
            self._program,
            self._form,
            None if answer.x is None else np.asarray(answer.x),
            s.row_duals(answer.y, answer.z),
            answer.z_box,
            iterations=iterations,
            claim=claim_from(words, bool(answer.found)),
            detail=words,
        )


def _own_words(extras: dict[str, Any]) -> tuple[str, int]:
    """Status text and iterations, wherever the package put them."""
    info = extras.get("info", extras)

    def get(key: str) -> Any:
        return info.get(key) if isinstance(info, dict) else getattr(info, key, None)

    iterations = next(
        (int(v) for k in ("iter", "iterations") if (v := get(k)) is not None), 0
    )
    return str(get("status") or ""), iterations


def claim_from(words: str, found: bool) -> Claim:
    """What a package's status text claims.

    Args:
        words: Status in the package's own words.
        found: Whether it says that it solved the problem.

    Returns:
        The claim.

    Raises:
        KeyboardInterrupt: It was interrupted; some packages take that for themselves.

    >>> claim_from("PROXQP_PRIMAL_INFEASIBLE", False)
    <Claim.INFEASIBLE: 'infeasible'>
    >>> claim_from("time limit reached", False)
    <Claim.TIME_LIMIT: 'time limit'>
    >>> claim_from("AlmostSolved", True).name
    'DOUBTS'
    """
    plain = words.lower().replace("_", "").replace(" ", "").replace("-", "")
    if "interrupt" in plain or "sigint" in plain:
        raise KeyboardInterrupt
    if "inaccurate" in plain or "almost" in plain:
        # also of infeasibility: a certificate in doubt does not count
        return Claim.PAUSED if "iter" in plain else Claim.DOUBTS
    if found:
        return Claim.DONE
    if "dualinfeasible" in plain or "unbounded" in plain:
        return Claim.UNBOUNDED
    if "infeasible" in plain:
        return Claim.INFEASIBLE
    if "time" in plain:
        return Claim.TIME_LIMIT
    if "iter" in plain:
        return Claim.PAUSED
    return Claim.GAVE_UP
