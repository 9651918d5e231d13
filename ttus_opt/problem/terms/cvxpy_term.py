"""A term from a cvxpy expression, to try an idea in one line.

    tt.fit(scene, eq10 + CvxpyTerm("edge", lambda p: cp.tv(p[:, :, 9]), weight=0.1))

cvxpy brings any convex expression φ into a canonical cone program (M. Grant, S. Boyd,
Y. Ye, Disciplined Convex Programming, 2006),

    φ(p) = min_y  cᵀ(p, y) + d   subject to   h − M (p, y) in zero, nonnegative and
                                              second-order cones,

whose objective, rows and auxiliary variables y become a linear term, constraints and a
variable of the program. Optimality is then verified as for any other program, without
cvxpy, down to the multiplier of every row; only the canonical form itself relies on
cvxpy. Exponential, power and semidefinite cones cannot be verified and are refused.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.scene import Scene
from ttus_opt.core.errors import InputError
from ttus_opt.core.plugins import user_errors
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.penalties import Linear
from ttus_opt.problem.terms.rows import ConeRows, LinearRows, replaced


@dataclass(frozen=True)
class CvxpyTerm:
    """A weighted convex cvxpy expression of the field, not yet bound to a scene.

    A formulation binds it to its own scene.

    Attributes:
        name: Name of its cost, weight and multipliers.
        expression: Function that returns a convex scalar. Its arguments
            (``lambda p: …``) name the fields it takes, cvxpy expressions of shape
            (n_r, n_θ, n_z).
        weight: Its λ, not negative [–].
    """

    name: str
    expression: Callable[..., Any]
    weight: float = 1.0

    def over(self, scene: Scene) -> CvxpyRows:
        """The same term over a scene."""
        return CvxpyRows(
            scene, self.weight, label=self.name, expression=self.expression
        )


@dataclass(frozen=True)
class CvxpyRows(Term):
    """A cvxpy expression over a scene: its canonical objective and rows.

    Attributes:
        label: The term's name.
        expression: As in `CvxpyTerm`.
    """

    label: str = field(kw_only=True)
    expression: Callable[..., Any] = field(kw_only=True, repr=False)

    penalty = Linear()  # of the canonical objective

    @property
    def name(self) -> str:
        """Its name."""
        return self.label

    @property
    def takes(self) -> tuple[str, ...]:
        """Names of the fields that the expression takes."""
        return tuple(inspect.signature(self.expression).parameters)

    @property
    def formula(self) -> str:
        """The expression as cvxpy prints it."""
        words = str(self._stated[0])
        return words if len(words) <= 60 else f"{words[:57]}…"

    def rows(self) -> AffineRows:
        """The canonical objective, one row c and the target −d."""
        return self._canonical[0]

    @property
    def requires(self) -> Mapping[str, LinearRows | ConeRows]:
        """The canonical rows: ``name:rows`` and ``name:cones``."""
        return self._canonical[1]

    def with_weight(self, weight: float) -> CvxpyRows:
        """The same term with another weight, without canonicalising it again."""
        return replaced(self, "assembled", "_stated", "_canonical", weight=weight)

    @cached_property
    def _stated(self) -> tuple[Any, dict[str, Any]]:
        """The checked expression and its variables by name."""
        import cvxpy as cp

        shape = self.scene.voxmap.grid.shape
        names = list(inspect.signature(self.expression).parameters)
        variables = {name: cp.Variable(shape, name=name) for name in names}
        with user_errors(f"the expression of term {self.name}"):
            stated = self.expression(*variables.values())
        what = f"term {self.name}: its expression"
        if not (isinstance(stated, cp.Expression) and stated.is_scalar()):
            raise InputError(
                f"{what} must be a scalar cvxpy expression (cp.sum may help), got "
                f"{getattr(stated, 'shape', type(stated).__name__)}"
            )
        if not (stated.is_convex() and stated.is_real()):
            raise InputError(
                f"{what} must be convex by cvxpy's rules (DCP), this one is "
                f"{stated.curvature.lower()}"
            )
        return stated, variables

    @cached_property
    def _canonical(self) -> tuple[AffineRows, dict[str, LinearRows | ConeRows]]:
        """Objective and rows of the cone program over (p, …, auxiliary variables)."""
        import cvxpy as cp

        stated, variables = self._stated
        problem = cp.Problem(cp.Minimize(stated))
        if problem.is_mixed_integer():
            raise InputError(f"term {self.name}: integer variables are not convex")
        with user_errors(f"cvxpy's canonical form of term {self.name}"):
            data, _, _ = problem.get_problem_data(
                cp.CLARABEL,
                canon_backend=cp.SCIPY_CANON_BACKEND,  # supports three dimensions
                solver_opts={"use_quad_obj": False},
            )
        self._refuse_other_cones(data)
        M, form, dims = sp.csc_array(data["A"]), data["param_prob"], data["dims"]
        cost, constant = np.asarray(data["c"]), float(form.apply_parameters()[1])
        h = np.asarray(data["b"], dtype=np.float64)
        if not np.isfinite(np.concatenate([M.data, h, cost, [constant]])).all():
            raise InputError(
                f"term {self.name}: its canonical form is not finite: check the "
                "numbers in the expression"
            )
        columns, auxiliary = {}, np.ones(M.shape[1], dtype=bool)
        for name, variable in variables.items():
            start = form.var_id_to_col.get(variable.id)
            if start is not None:  # the expression may not use a variable
                # the first index varies fastest in cvxpy, the last one on the grid
                number = np.arange(variable.size).reshape(variable.shape, order="F")
                columns[name] = start + number.reshape(-1)
                auxiliary[columns[name]] = False
        if auxiliary.any():
            columns[f"{self.name}:aux"] = np.flatnonzero(auxiliary)
        blocks = {name: sp.csr_array(M[:, at]) for name, at in columns.items()}
        # rows h − M x: zero ones, nonnegative ones, then those of the cones
        equal, linear = int(dims.zero), int(dims.zero) + int(dims.nonneg)
        held: dict[str, LinearRows | ConeRows] = {}
        if linear:
            lower = np.where(np.arange(linear) < equal, h[:linear], -np.inf)
            own = {k: block[:linear] for k, block in blocks.items()}
            held[f"{self.name}:rows"] = LinearRows(own, lower, h[:linear])
        if dims.soc:
            sizes = tuple(int(size) for size in dims.soc)
            own = {k: -block[linear:] for k, block in blocks.items()}
            held[f"{self.name}:cones"] = ConeRows(own, h[linear:], sizes)
        rows = {k: sp.csr_array(cost[None, at]) for k, at in columns.items()}
        return AffineRows(rows, np.array([-constant])), held

    def _refuse_other_cones(self, data: Mapping[str, Any]) -> None:
        """Refuse cones and bounds that cannot be verified here."""
        dims = data["dims"]
        others = {
            "exponential": dims.exp,
            "power": len(dims.p3d) + len(getattr(dims, "pnd", ())),
            "semidefinite": len(dims.psd),
        }
        kinds = [name for name, count in others.items() if count]
        if kinds:
            raise InputError(
                f"term {self.name} needs {' and '.join(kinds)} cones, which cannot be "
                "verified here: use an expression of linear and second-order cones "
                "(norms, squares, huber, tv)"
            )
        if any(data.get(key) is not None for key in ("lower_bounds", "upper_bounds")):
            raise InputError(
                f"term {self.name}: variables with their own bounds are not "
                "supported: add a constraint"
            )
