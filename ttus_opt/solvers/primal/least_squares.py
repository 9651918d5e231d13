"""The objective as a function of the field alone, and its preconditioner."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ttus_opt.arrays import Array, Mask
from ttus_opt.multigrid.one_cycle import OneCycle
from ttus_opt.solvers.dual.linear_parameters import Complement
from ttus_opt.solvers.dual.options import DualOptions
from ttus_opt.solvers.primal.approximate_system import (
    ApproximateLaplace,
    ApproximateSystem,
)
from ttus_opt.solvers.primal.conjugate_gradients import Pair, inner_product
from ttus_opt.solvers.primal.options import PrimalOptions
from ttus_opt.solvers.primal.preconditioner import ConstraintPreconditioner
from ttus_opt.solvers.primal.split import Split
from ttus_opt.solvers.primal.unseen_fields import UnseenFields
from ttus_opt.solvers.primal.wide_term import WideTerm

#: Relative residual of the solve behind a bound [–]
ROUGHLY = 1e-2


@dataclass(frozen=True)
class LeastSquares:
    """F(p) = min over c of the objective, over the prior's weight.

    Attributes:
        split: The terms.
        complement: Across the columns of the unknowns c that are free.
    """

    split: Split
    complement: Complement = field(repr=False)

    def measure(self, p: Array) -> Array:
        """D p across the columns of c, shape (m,)."""
        return self.complement.part(self.split.few.system.measure(p))

    def misfit(self, p: Array) -> Array:
        """What the few rows leave, t - D p, shape (m,)."""
        return self.split.few.t - self.split.few.system.measure(p)

    def coefficients(self, p: Array) -> Array:
        """The best c beside p, shape (k,)."""
        return self.complement.coefficients(self.misfit(p))

    def start(self) -> Pair:
        """Given values alone, and no multipliers."""
        return Pair(self.split.given, np.zeros_like(self.split.few.t))

    def residual(self, at: Pair) -> Pair:
        """What is left of both equations; zero at given values."""
        r = self._of_rows(at.y)
        for term in self._terms:
            r += term.weight * (term.matrix.T @ (term.target - term.matrix @ at.p))
        s = self.complement.part(self.misfit(at.p)) - at.y
        return Pair(np.where(self.split.moving, r, 0.0), s)

    def image(self, along: Pair) -> tuple[Pair, Array]:
        """By how much both fall along a direction, and D times its field."""
        r = -self._of_rows(along.y)
        for term in self._terms:
            r += term.weight * (term.matrix.T @ (term.matrix @ along.p))
        measured = self.measure(along.p)
        return Pair(np.where(self.split.moving, r, 0.0), measured + along.y), measured

    def gradient(self, rest: Pair) -> Array:
        """Minus half the gradient, shape (V,); zero at given values."""
        return np.where(self.split.moving, rest.p + self._of_rows(rest.y), 0.0)

    def value(self, p: Array) -> float:
        """F(p)."""
        total = float(np.sum(self.complement.part(self.misfit(p)) ** 2))
        for term in self._terms:
            r = term.matrix @ p - term.target
            total += term.weight * inner_product(r, r)
        return total

    def gap_bound(self, at: Pair) -> float:
        """A bound of F(p) - F(p*): rᵀP⁻¹r of the Laplace term alone, about."""
        system = self.split.few.system
        r = self.gradient(self.residual(at))
        u = system.laplace.solve_adjoint(r, rtol=ROUGHLY)
        return float(np.sum(system.compliance * u**2))

    @property
    def _terms(self) -> tuple[WideTerm, ...]:
        return (self.split.prior, *self.split.wide)

    def _of_rows(self, y: Array) -> Array:
        """Dᵀy, shape (V,)."""
        system = self.split.few.system
        return np.asarray(system.adjoint @ (system.root_weights * y))


def preconditioner(
    split: Split,
    free: Mask,
    options: PrimalOptions,
    dual: DualOptions,
) -> ConstraintPreconditioner:
    """The preconditioner of a split program.

    Args:
        split: The terms.
        free: Which unknowns beside the field are free, shape (k,).
        options: Of the method.
        dual: Of the dual.
    """
    laplace = split.operator
    unseen = UnseenFields.of(split.prior, split.wide, split.moving)
    root = split.root(unseen is not None)
    grid, grounds = laplace.operator_grid, laplace.grounds
    cycle = OneCycle(grid, laplace.free, root.added, grounds=grounds)
    approximate = ApproximateLaplace.of(laplace, cycle, root.coupling)
    system = ApproximateSystem.of(split.few.system, approximate, split.wide, unseen)
    return ConstraintPreconditioner(
        system, split.few.columns[:, free], options.inner, dual
    )
