"""ProxQP: proximal augmented Lagrangian, in C++."""

from __future__ import annotations

from typing import Any

from ttus_opt.solvers.base import Capabilities
from ttus_opt.solvers.qpsolvers_base import QpsolversSolver


class ProxQP(QpsolversSolver):
    """ProxQP's sparse solver on the least-squares form."""

    name = "proxqp"
    summary = "proximal augmented Lagrangian (ProxQP)"
    capabilities = Capabilities(inequalities=True, equalities=True, time_limit=False)
    module = "proxsuite"
    pip_name = "proxsuite"
    margin = 0.1

    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """Residual and gap tolerances; it knows no time limit."""
        return {
            "eps_abs": eps * 1e-2,  # absolute: entries here are often far below one
            "eps_rel": eps,
            "check_duality_gap": True,
            "eps_duality_gap_abs": eps * 1e-2,
            "eps_duality_gap_rel": eps,
        }


SOLVERS = [ProxQP()]
