"""Clarabel behind cvxpy: interior point on the cone form."""

from __future__ import annotations

from typing import Any

from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Capabilities
from ttus_opt.solvers.cvxpy_base import CvxpySolver
from ttus_opt.solvers.sizes import interior_point_seconds


class CvxpyClarabel(CvxpySolver):
    """Clarabel through cvxpy."""

    name = "cvxpy_clarabel"
    summary = "interior point through cvxpy (Clarabel): any penalty"
    capabilities = Capabilities(inequalities=True, equalities=True, nonquadratic=True)
    module = "clarabel"
    pip_name = "cvxpy clarabel"
    backend = "CLARABEL"

    def cost(self, program: Program) -> float:
        """Of an interior point method, and of stating it in cvxpy."""
        return 0.05 + 1.1 * interior_point_seconds(program)

    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """Gap and feasibility tolerances and a time limit."""
        options: dict[str, Any] = {
            "tol_gap_abs": eps,
            "tol_gap_rel": eps,
            "tol_feas": eps,
        }
        return options | ({} if seconds is None else {"time_limit": seconds})


SOLVERS = [CvxpyClarabel()]
