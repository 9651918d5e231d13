"""SCS: splitting with a homogeneous embedding and Anderson acceleration, in C.

Used directly to keep the solver object: new measured values change only its vectors b
and c, with the same factor and a warm start.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Capabilities, Claim, Request, Solver
from ttus_opt.solvers.packages.qp_packages import claim_from
from ttus_opt.solvers.packages.quadratic import OneSided, TwoSided, read_back
from ttus_opt.solvers.sizes import splitting_seconds
from ttus_opt.solvers.verified import Verified

#: Iterations between two checks of the iterate, and most checks
ITERATIONS, CHECKS = 5_000, 40


class Scs(Solver):
    """SCS on the least-squares form."""

    name = "scs"
    summary = "splitting (SCS), keeps its factor and its last answer"
    capabilities = Capabilities(
        inequalities=True,
        equalities=True,
        keeps="factor and last answer for new values; nothing for new weights",
    )
    module = "scs"
    pip_name = "scs"

    def cost(self, program: Program) -> float:
        """That of a splitting method."""
        return splitting_seconds(program)

    def prepare(self, program: Program, request: Request) -> Verified:
        """Load, scale and factorise."""
        self.require(program)
        return _Loaded(program, request)


class _Loaded(Verified):
    """A live SCS object over A x + s = b with s in zero and nonnegative cones."""

    margin = 0.1
    floor = 1e-12
    continuations = CHECKS

    def __init__(self, program: Program, request: Request) -> None:
        self._rows: TwoSided | None = None
        self._solver: Any = None
        self._set_with = np.nan  # the tolerance at set-up
        self._last: dict[str, Array] | None = None
        super().__init__(program, request)

    def _load(self, program: Program) -> None:
        self._form = program.least_squares_qp()
        rows = TwoSided.of(self._form)
        before = self._rows
        same = (
            before is not None
            and rows.same_structure(before)
            and np.array_equal(rows.A.data, before.A.data)
            and np.array_equal(rows.P.data, before.P.data)
        )
        self._rows, self._split = rows, OneSided.of(rows.form)
        self._b = np.concatenate([self._split.b, self._split.h])
        if same and self._solver is not None:
            self._solver.update(self._b, rows.q)
        else:
            self._last = None
            self._solver = self._set_up(self._eps, self._request.time_limit)

    def _set_up(self, eps: float, seconds: float | None) -> Any:
        """A factorised solver; None where SCS refuses the data."""
        import scs  # type: ignore[import-untyped,unused-ignore]

        self._set_with, split = eps, self._split
        data = {
            "P": sp.csc_matrix(sp.triu(split.P)),
            "A": sp.csc_matrix(sp.vstack([split.A, split.G])),
            "b": self._b,
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

    def _attempt(self, eps: float, seconds: float | None) -> Candidate:
        assert self._rows is not None
        if self._set_with != eps:
            self._solver = self._set_up(eps, seconds)
        if self._solver is None:
            return Candidate(None, claim=Claim.GAVE_UP, detail="SCS refuses the data")
        if self._last is None:
            answer = self._solver.solve(warm_start=False)
        else:
            answer = self._solver.solve(warm_start=True, **self._last)
        words = str(answer["info"]["status"])
        claim = claim_from(words, words == "solved")
        if claim in (Claim.INFEASIBLE, Claim.UNBOUNDED):
            self._last = None
            return Candidate(None, claim=claim, detail=words)
        self._last = {key: np.array(answer[key]) for key in ("x", "y", "s")}
        n_equal = len(self._split.b)
        y = self._split.row_duals(answer["y"][:n_equal], answer["y"][n_equal:])
        rows, box = self._rows.split(y)
        return read_back(
            self._program,
            self._form,
            np.asarray(answer["x"]),
            rows,
            box,
            iterations=int(answer["info"]["iter"]),
            claim=claim,
            detail=words,
        )


SOLVERS = [Scs()]
