"""Splitting methods in C that keep one factor over all iterations: OSQP and SCS.

Used directly, not through qpsolvers, to keep the solver object. New measured values
change only vectors (same factor, warm start). New weights change values of A: OSQP
(ADMM) refactorises in the same ordering; SCS (a homogeneous embedding with Anderson
acceleration) cannot take another matrix.
"""

from __future__ import annotations

import abc
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Capabilities, Claim, Solver
from ttus_opt.solvers.packages.qp_packages import claim_from
from ttus_opt.solvers.packages.quadratic import OneSided, TwoSided, read_back
from ttus_opt.solvers.sizes import splitting_seconds
from ttus_opt.solvers.verified import Verified, seconds_left

#: Iterations between two checks of the iterate, and most checks
ITERATIONS, CHECKS = 5_000, 40


class SplittingSolver(Solver):
    """A package whose name is its module's."""

    def __init__(
        self, loaded: type[Loaded], summary: str, keeps: str, slower: float = 1.0
    ) -> None:
        self.name = self.module = self.pip_name = loaded.package
        self.loaded, self._slower, self.summary = loaded, slower, summary
        self.capabilities = Capabilities(
            inequalities=True, equalities=True, keeps=keeps
        )

    def cost(self, program: Program) -> float:
        """That of a splitting method."""
        return self._slower * splitting_seconds(program)


class Loaded(Verified):
    """A live solver object over rows between limits; None where it refuses the data."""

    package: ClassVar[str]
    margin, floor, continuations = 0.1, 1e-12, CHECKS
    _solver: Any = None
    _rows: TwoSided
    _last: dict[str, Array] | None = None  # where the object does not keep it

    def _load(self, program: Program) -> None:
        self._form = program.least_squares_qp()
        rows = TwoSided.of(self._form)
        before, self._rows = getattr(self, "_rows", rows), rows
        same = self._solver is not None and rows.same_structure(before)
        if not (same and self._kept(before)):
            self._last = None
            self._solver = self._set_up(self._eps, self._request.time_limit)

    @abc.abstractmethod
    def _set_up(self, eps: float, seconds: float | None) -> Any:
        """A factorised solver."""

    @abc.abstractmethod
    def _kept(self, before: TwoSided) -> bool:
        """Hand rows of the same structure to the live solver; False if it cannot."""

    def _attempt(self, eps: float, deadline: float | None) -> Candidate:
        if self._solver is None:
            words = f"{self.package.upper()} refuses the data"
            return Candidate(None, claim=Claim.GAVE_UP, detail=words)
        return self._solved(eps, seconds_left(deadline))

    @abc.abstractmethod
    def _solved(self, eps: float, seconds: float | None) -> Candidate:
        """The live solver's answer."""

    def _read(self, x: Any, y: Array, words: str, iterations: int) -> Candidate:
        """An answer with multipliers of the two-sided rows."""
        claim = claim_from(words, words == "solved")
        if claim in (Claim.INFEASIBLE, Claim.UNBOUNDED):
            self._last = None
            return Candidate(None, claim=claim, detail=words)
        return read_back(
            self._program,
            self._form,
            np.asarray(x, dtype=np.float64),
            *self._rows.split(y),
            iterations=iterations,
            claim=claim,
            detail=words,
        )


class OsqpLoaded(Loaded):
    """A live OSQP object."""

    package = "osqp"

    def _set_up(self, eps: float, seconds: float | None) -> Any:
        import osqp

        solver, rows = osqp.OSQP(), self._rows
        P = sp.csc_matrix(sp.triu(rows.P))
        try:
            solver.setup(
                P, rows.q, rows.A, rows.lower, rows.upper,
                verbose=False, max_iter=ITERATIONS, polishing=False,
            )  # fmt: skip
        except osqp.OSQPException:
            return None
        return solver

    def _kept(self, before: TwoSided) -> bool:
        rows, changed = self._rows, dict[str, Any]()
        if not np.array_equal(rows.A.data, before.A.data):
            changed["Ax"] = rows.A.data
        if not np.array_equal(rows.P.data, before.P.data):
            changed["Px"] = sp.triu(rows.P, format="csc").data
        self._solver.update(q=rows.q, l=rows.lower, u=rows.upper, **changed)
        return True

    def _solved(self, eps: float, seconds: float | None) -> Candidate:
        # residuals here are often far below one: the default absolute tolerance would
        # accept a dual residual of 1e-2
        limit = 1e10 if seconds is None else seconds
        self._solver.update_settings(eps_abs=eps * 1e-2, eps_rel=eps, time_limit=limit)
        answer = self._solver.solve(raise_error=False)
        words, y = str(answer.info.status), np.asarray(answer.y, dtype=np.float64)
        found = self._read(answer.x, y, words, int(answer.info.iter))
        if found.claim is Claim.DOUBTS:  # "solved inaccurate": out of iterations
            return replace(found, claim=Claim.PAUSED)
        return found


class ScsLoaded(Loaded):
    """A live SCS object over A x + s = b with s in zero and nonnegative cones."""

    package = "scs"

    def _set_up(self, eps: float, seconds: float | None) -> Any:
        import scs  # type: ignore[import-untyped,unused-ignore]

        self._set_with, split = eps, OneSided.of(self._rows.form)
        self._split = split
        data = {
            "P": sp.csc_matrix(sp.triu(split.P)),
            "A": sp.csc_matrix(sp.vstack([split.A, split.G])),
            "b": np.concatenate([split.b, split.h]),
            "c": split.q,
        }
        try:
            return scs.SCS(
                data,
                {"z": len(split.b), "l": len(split.h)},
                verbose=False,
                eps_abs=eps * 1e-2,
                eps_rel=eps,
                max_iters=ITERATIONS,
                time_limit_secs=0.0 if seconds is None else seconds,
            )
        except ValueError:  # "ScsWork allocation error!"
            return None

    def _kept(self, before: TwoSided) -> bool:
        rows = self._rows
        if not all(
            np.array_equal(new.data, old.data)
            for new, old in ((rows.A, before.A), (rows.P, before.P))
        ):
            return False
        self._split = split = OneSided.of(rows.form)
        self._solver.update(np.concatenate([split.b, split.h]), rows.q)
        return True

    def _solved(self, eps: float, seconds: float | None) -> Candidate:
        if self._set_with != eps:
            self._solver = self._set_up(eps, seconds)
        last = self._last or {}
        answer = self._solver.solve(warm_start=bool(last), **last)
        self._last = {key: np.array(answer[key]) for key in ("x", "y", "s")}
        n_equal, info = len(self._split.b), answer["info"]
        y = self._split.sides.multipliers(answer["y"][:n_equal], answer["y"][n_equal:])
        return self._read(answer["x"], y, str(info["status"]), int(info["iter"]))


SOLVERS = [
    SplittingSolver(
        OsqpLoaded,
        "operator splitting (OSQP), keeps its factor and its last answer",
        "factor and last answer for new values; the ordering for new weights",
        slower=3.0,
    ),
    SplittingSolver(
        ScsLoaded,
        "splitting (SCS), keeps its factor and its last answer",
        "factor and last answer for new values; nothing for new weights",
    ),
]
