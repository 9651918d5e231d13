"""PIQP: proximal interior point, in C++."""

from __future__ import annotations

from typing import Any

from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Capabilities
from ttus_opt.solvers.qpsolvers_base import QpsolversSolver
from ttus_opt.solvers.sizes import interior_point_seconds


class Piqp(QpsolversSolver):
    """PIQP's sparse solver on the least-squares form."""

    name = "piqp"
    summary = "proximal interior point (PIQP)"
    capabilities = Capabilities(inequalities=True, equalities=True, time_limit=False)
    module = "piqp"
    pip_name = "piqp"
    margin = 0.1

    def cost(self, program: Program) -> float:
        """Of an interior point method with a slower factor."""
        return 1.5 * interior_point_seconds(program)

    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """Residual and gap tolerances; it knows no time limit."""
        return {
            "eps_abs": eps,
            "eps_rel": eps,
            "check_duality_gap": True,
            "eps_duality_gap_abs": eps,
            "eps_duality_gap_rel": eps,
        }


SOLVERS = [Piqp()]
