"""Clarabel: interior point with a homogeneous embedding, in Rust."""

from __future__ import annotations

from typing import Any

from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Capabilities
from ttus_opt.solvers.qpsolvers_base import QpsolversSolver
from ttus_opt.solvers.sizes import interior_point_seconds


class Clarabel(QpsolversSolver):
    """Clarabel on the sparse least-squares form."""

    name = "clarabel"
    summary = "interior point (Clarabel)"
    capabilities = Capabilities(inequalities=True, equalities=True)
    module = "clarabel"
    pip_name = "clarabel"
    margin = 0.1  # an iteration more is cheaper than a second solve

    def cost(self, program: Program) -> float:
        """Of an interior point method."""
        return interior_point_seconds(program)

    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """Gap and feasibility tolerances; the absolute ones never decide alone."""
        options: dict[str, Any] = {
            "tol_gap_abs": eps,
            "tol_gap_rel": eps,
            "tol_feas": eps,
        }
        return options | ({} if seconds is None else {"time_limit": seconds})


SOLVERS = [Clarabel()]
