"""HiGHS: active-set method for convex QP, in C++."""

from __future__ import annotations

from typing import Any

import numpy as np

from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Capabilities
from ttus_opt.solvers.qpsolvers_base import QpsolversSolver

#: Added to the Hessian's diagonal: its default of 1e-7 bounds the residual from below
#: near 1e-4, without any (0.0) it gives up on penalties with a kink
REGULARISATION = 1e-11


class Highs(QpsolversSolver):
    """HiGHS' QP solver on the least-squares form; for small problems."""

    name = "highs"
    summary = "active set (HiGHS): exact, for thousands of voxels at most"
    capabilities = Capabilities(inequalities=True, equalities=True)
    module = "highspy"
    pip_name = "highspy"

    def refusal(self, program: Program) -> str:
        """Nothing without an inequality: it then says "optimal" with infinite x."""
        base = super().refusal(program)
        if base:
            return base
        bounded = any(np.isfinite(limit).any() for limit in program.box)
        if bounded or any((c.lower < c.upper).any() for c in program.constraints):
            return ""
        return "HiGHS goes wrong without an inequality"

    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """Feasibility tolerances, which HiGHS takes down to 1e-10."""
        options: dict[str, Any] = {
            "primal_feasibility_tolerance": max(eps, 1e-10),
            "dual_feasibility_tolerance": max(eps, 1e-10),
            "qp_regularization_value": REGULARISATION,
        }
        return options | ({} if seconds is None else {"time_limit": float(seconds)})


SOLVERS = [Highs()]
