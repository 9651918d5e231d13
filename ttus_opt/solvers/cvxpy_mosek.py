"""MOSEK behind cvxpy: commercial interior point, for who has a licence."""

from __future__ import annotations

from typing import Any

from ttus_opt.solvers.base import Capabilities
from ttus_opt.solvers.cvxpy_base import CvxpySolver


class CvxpyMosek(CvxpySolver):
    """MOSEK through cvxpy."""

    name = "cvxpy_mosek"
    summary = "interior point through cvxpy (MOSEK, commercial): any penalty"
    capabilities = Capabilities(inequalities=True, equalities=True, nonquadratic=True)
    module = "mosek"
    pip_name = "cvxpy mosek"
    backend = "MOSEK"

    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """Conic tolerances and a time limit."""
        parameters: dict[str, Any] = {
            f"MSK_DPAR_INTPNT_CO_TOL_{which}": eps
            for which in ("PFEAS", "DFEAS", "REL_GAP", "MU_RED")
        }
        if seconds is not None:
            parameters["MSK_DPAR_OPTIMIZER_MAX_TIME"] = seconds
        return {"mosek_params": parameters}


SOLVERS = [CvxpyMosek()]
