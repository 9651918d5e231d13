"""Further sparse QP packages that qpsolvers knows, for who has them installed.

Commercial or young: they are not part of this project's own test runs, but the
tests take in whatever is installed, and every answer is checked in any case. What
qpsolvers reaches through CVXOPT (MOSEK among them) is left out: its licence is the
GPL; MOSEK is reached through cvxpy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ttus_opt.solvers.base import Capabilities
from ttus_opt.solvers.qpsolvers_base import QpsolversSolver


class FurtherQP(QpsolversSolver):
    """A package described by the names of its options."""

    margin = 0.1

    def __init__(
        self,
        name: str,
        module: str,
        pip_name: str,
        summary: str,
        tolerances: tuple[str, ...],
        time_limit: str,
        fixed: Mapping[str, Any],
    ) -> None:
        self.name, self.summary = name, summary
        self.module, self.pip_name = module, pip_name
        self.capabilities = Capabilities(
            inequalities=True, equalities=True, time_limit=bool(time_limit)
        )
        self._tolerances, self._time_limit = tolerances, time_limit
        self._fixed = dict(fixed)

    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """The tolerance under each of its names."""
        options = dict.fromkeys(self._tolerances, eps) | self._fixed
        if self._time_limit and seconds is not None:
            options[self._time_limit] = seconds
        return options


SOLVERS = [
    FurtherQP(
        "gurobi",
        "gurobipy",
        "gurobipy",
        "interior point (Gurobi, commercial)",
        ("BarConvTol",),  # its feasibility tolerances end at 1e-9
        "TimeLimit",
        {"FeasibilityTol": 1e-9, "OptimalityTol": 1e-9},
    ),
    FurtherQP(
        "copt",
        "coptpy",
        "coptpy",
        "interior point (COPT, commercial)",
        (),  # its own tolerances end at 1e-9
        "TimeLimit",
        {"FeasTol": 1e-9, "DualTol": 1e-9},
    ),
    FurtherQP(
        "qtqp",
        "qtqp",
        "qtqp",
        "interior point (QTQP)",
        ("atol", "rtol"),
        "",
        {},
    ),
    FurtherQP(
        "sip",
        "sip_qp_python",
        "sip-qp-python",
        "barrier augmented Lagrangian (SIP)",
        ("eps_abs", "eps_rel"),
        "time_limit",
        {},
    ),
]
