"""Sparse QP packages through qpsolvers, one entry each.

Every package gets the least-squares form, which has equality rows: without any,
qpsolvers solves by LSQR for several packages and may report a false "unbounded below".
Matrices are ``csc_matrix``, as qpsolvers does not take ``csc_array`` for sparse. Duals
have our signs (`ttus_opt.solvers.packages.quadratic`).

Packages behind CVXOPT (MOSEK among them) are left out for its GPL licence; MOSEK is
available through cvxpy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Claim
from ttus_opt.solvers.packages.package import PackageLoaded, PackageSolver
from ttus_opt.solvers.packages.quadratic import OneSided, read_back


class _Loaded(PackageLoaded):
    """A program in qpsolvers' form."""

    def _load(self, program: Program) -> None:
        self._form = program.least_squares_qp()
        self._split = OneSided.of(self._form)

    def _solved(self, options: Mapping[str, Any]) -> Any:
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
        return qpsolvers.solve_problem(problem, solver=self._backend.name, **options)

    def _read(self, answer: Any) -> Candidate:
        s = self._split
        words, iterations = _own_words(answer.extras or {})
        return read_back(
            self._program,
            self._form,
            None if answer.x is None else np.asarray(answer.x),
            s.sides.multipliers(answer.y, answer.z),
            answer.z_box,
            iterations=iterations,
            claim=claim_from(words, bool(answer.found)),
            detail=words,
        )

    def _errors(self) -> tuple[type[Exception], ...]:
        import qpsolvers

        return (qpsolvers.SolverError, ValueError, RuntimeError)


class QpPackage(PackageSolver):
    """One of qpsolvers' packages."""

    loaded = _Loaded


class Highs(QpPackage):
    """HiGHS' QP solver; for small problems."""

    def refusal(self, program: Program) -> str:
        """Refuses problems without inequalities: HiGHS returns an infinite x."""
        if base := super().refusal(program):
            return base
        bounded = any(np.isfinite(limit).any() for limit in program.box)
        if bounded or any((c.lower < c.upper).any() for c in program.constraints):
            return ""
        return "HiGHS goes wrong without an inequality"


def _own_words(extras: dict[str, Any]) -> tuple[str, int]:
    """Status text and iterations, from the package's own fields."""
    info = extras.get("info", extras)

    def get(key: str) -> Any:
        return info.get(key) if isinstance(info, dict) else getattr(info, key, None)

    iterations = next(
        (int(v) for k in ("iter", "iterations") if (v := get(k)) is not None), 0
    )
    return str(get("status") or ""), iterations


def claim_from(words: str, found: bool) -> Claim:
    """The claim of a package's status text.

    Args:
        words: Status text of the package.
        found: Whether the package reports the problem as solved.

    Raises:
        KeyboardInterrupt: The status is an interrupt, which some packages catch.

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
        # of infeasibility too: an inaccurate certificate does not count
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


#: Added to the Hessian's diagonal by HiGHS: with its default of 1e-7 residuals stay
#: near 1e-4, with 0.0 it fails on penalties with a kink
REGULARISATION = 1e-11


SOLVERS = [
    QpPackage(
        "clarabel",
        "interior point (Clarabel)",
        "clarabel",
        ("tol_gap_abs", "tol_gap_rel", "tol_feas"),
        time_limit="time_limit",
        effort=1.0,
    ),
    QpPackage(
        "piqp",
        "proximal interior point (PIQP)",
        "piqp",
        ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"),
        fixed={"check_duality_gap": True},
        effort=1.5,
    ),
    QpPackage(
        "proxqp",
        "proximal augmented Lagrangian (ProxQP)",
        "proxsuite",
        ("eps_rel", "eps_duality_gap_rel"),
        absolute=("eps_abs", "eps_duality_gap_abs"),
        fixed={"check_duality_gap": True},
    ),
    QpPackage(
        "qpalm",
        "proximal augmented Lagrangian (QPALM)",
        "qpalm",
        ("eps_rel",),
        absolute=("eps_abs",),
        time_limit="time_limit",
    ),
    Highs(
        "highs",
        "active set (HiGHS): exact, for thousands of voxels at most",
        "highspy",
        ("primal_feasibility_tolerance", "dual_feasibility_tolerance"),
        time_limit="time_limit",
        fixed={"qp_regularization_value": REGULARISATION},
        least=1e-10,
        margin=1.0,
    ),
    # commercial or young: not installed in this project's own test runs; the tests run
    # every solver that is installed
    QpPackage(
        "gurobi",
        "interior point (Gurobi, commercial)",
        "gurobipy",
        ("BarConvTol",),
        time_limit="TimeLimit",
        fixed={"FeasibilityTol": 1e-9, "OptimalityTol": 1e-9},  # its least
    ),
    QpPackage(
        "copt",
        "interior point (COPT, commercial)",
        "coptpy",
        time_limit="TimeLimit",
        fixed={"FeasTol": 1e-9, "DualTol": 1e-9},  # its least
    ),
    QpPackage("qtqp", "interior point (QTQP)", "qtqp", ("atol", "rtol")),
    QpPackage(
        "sip",
        "barrier augmented Lagrangian (SIP)",
        "sip_qp_python",
        ("eps_abs", "eps_rel"),
        time_limit="time_limit",
        pip_name="sip-qp-python",
    ),
]
