"""SCS behind cvxpy: splitting on the cone form."""

from __future__ import annotations

from typing import Any

from ttus_opt.solvers.base import Capabilities
from ttus_opt.solvers.cvxpy_base import CvxpySolver


class CvxpyScs(CvxpySolver):
    """SCS through cvxpy."""

    name = "cvxpy_scs"
    summary = "splitting through cvxpy (SCS): any penalty"
    capabilities = Capabilities(inequalities=True, equalities=True, nonquadratic=True)
    module = "scs"
    pip_name = "cvxpy scs"
    backend = "SCS"
    margin = 0.1

    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """Residual tolerances and a time limit."""
        options: dict[str, Any] = {
            "eps_abs": eps * 1e-2,
            "eps_rel": eps,
            "max_iters": 20_000,
        }
        return options | ({} if seconds is None else {"time_limit_secs": seconds})


SOLVERS = [CvxpyScs()]
