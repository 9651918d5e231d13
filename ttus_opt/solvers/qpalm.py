"""QPALM: proximal augmented Lagrangian with rank updates of its factor, in C."""

from __future__ import annotations

from typing import Any

from ttus_opt.solvers.base import Capabilities
from ttus_opt.solvers.qpsolvers_base import QpsolversSolver


class Qpalm(QpsolversSolver):
    """QPALM on the least-squares form."""

    name = "qpalm"
    summary = "proximal augmented Lagrangian (QPALM)"
    capabilities = Capabilities(inequalities=True, equalities=True)
    module = "qpalm"
    pip_name = "qpalm"
    margin = 0.1

    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """Outer tolerances and a time limit."""
        options: dict[str, Any] = {"eps_abs": eps * 1e-2, "eps_rel": eps}
        return options | ({} if seconds is None else {"time_limit": seconds})


SOLVERS = [Qpalm()]
