"""Bound of the gap where squares do not determine x: other multipliers absorb r.

Penalties φ ≥ 0 other than squares (absolute values, groups, Huber's) have multipliers g
in the set G of all subgradients. The gradient r of the Lagrangian is distributed,

    (Σ_k M_kᵀM_k + θ P) d ≈ r,    s_k = M_k d,    r = Σ_k M_kᵀs_k + θ P d + ρ,

and with w_k g′_k = w_k g_k − s_k the remaining gradient is θ P d + ρ. A g′ outside G
lies in t G for some t > 1, and t φ(r) + t φ*(g′/t) ≥ g′ᵀr by Fenchel's inequality for
g′/t. At the optimum Σ w φ ≤ f* ≤ f(x), hence with r_k = M_k x − t_k

    f(x) − f* ≤ complementarity + Σ_k w_k (φ(r_k) + t_k φ*(g′_k/t_k) − g′_kᵀr_k)
                + max_k (t_k − 1) f(x) + ½ θ² dᵀP d + ρᵀ(x − x*).

The summands are signed: clipping g to G moves an amount from the second summand to r,
and both cancel here. The last is at most the product of ρ's norm in the inverse of the
matrix above and that of x − x* in the matrix itself; the latter is bounded because
neither x nor x* has an objective above f(x). θ = 0 is tried first, then a positive one.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import NumericalError
from ttus_opt.laplace.network import NeighbourRows, by_network
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.penalties import Linear
from ttus_opt.problem.verify.distance import CLOSE, RTOL, field_of, steps

_Map = Callable[[Array], Array]

#: Most steps of conjugate gradients without squares (θ = 0), and with them
STEPS, STEPS_BESIDE = 40, 200

#: Part of the requested gap to which the last summand is reduced [–]
CLOSE_ENOUGH = 1e-2

#: Largest bound at θ = 0, over the requested gap, for which θ > 0 is tried [–]
HOPEFUL = 1e3

#: Factor on a norm that is measured with the preconditioner [–]
GENEROUS = 3.0


@dataclass(frozen=True)
class Absorbed:
    """Result of `absorbed`.

    Attributes:
        gap: All summands of the bound except complementarity.
        taken: Σ Mᵀs, the part of r that multipliers have absorbed, shape (n,).
        is_close: Whether the last summand is negligible.
    """

    gap: float
    taken: Array = field(repr=False)
    is_close: bool


def absorbed(
    program: Program,
    x: Array,
    multipliers: Mapping[str, Array],
    residual: Array,
    fixed: Mask,
    goal: float,
) -> Absorbed | None:
    """The bound of the module's docstring.

    Args:
        program: The program.
        x: A candidate, shape (n,).
        multipliers: g of the terms that are neither squares nor linear, by name.
        residual: r, the gradient of the Lagrangian, shape (n,).
        fixed: Variables that equalities hold, shape (n,).
        goal: The requested gap; the last summand need not be far below it.

    Returns:
        The bound; None without such a penalty, with one that has no `gauge`, or with a
        linear one, whose value is not bounded below.
    """
    terms = [t for t in program.terms if t.weight > 0.0 and not t.penalty.quadratic]
    if not terms or any(isinstance(t.penalty, Linear) for t in program.terms):
        return None
    r, enough = np.where(fixed, 0.0, residual), CLOSE_ENOUGH * goal
    rows = _Rows(program, x, multipliers, terms, fixed)
    try:
        best = rows.bound(r, 0.0, STEPS, enough)
        hopeless = best.is_close and not best.gap < HOPEFUL * goal
        if best.gap > goal and not hopeless:
            new = rows.bound(r, rows.theta, STEPS_BESIDE, enough)
            best = min(best, new, key=lambda one: one.gap)
    except NumericalError:  # of the multigrid: no bound without its solves
        return None
    return best if np.isfinite(best.gap) else None


class _Rows:
    """Residuals and multipliers of the penalties, and their bound.

    Steps for it are in the matrix Σ MᵀM + θ P over the free variables.
    """

    def __init__(
        self,
        program: Program,
        x: Array,
        multipliers: Mapping[str, Array],
        terms: list[ProgramTerm],
        fixed: Mask,
    ) -> None:
        self._program, self._terms, self._fixed = program, terms, fixed
        self._objective = program.objective(x)
        self._residuals = [t.residual(x) for t in terms]
        self._g = [multipliers[t.name] for t in terms]
        self._values = [
            t.penalty.value(r) for t, r in zip(terms, self._residuals, strict=True)
        ]

    @property
    def theta(self) -> float:
        """Θ that balances the curvatures of squares and rows at these residuals."""
        terms = zip(self._terms, self._values, strict=True)
        mean = max(value / len(t.target) / t.weight for t, value in terms)
        return float(mean) or 1.0

    def bound(self, r: Array, theta: float, most: int, enough: float) -> Absorbed:
        """Conjugate gradients until the last summand is negligible."""
        apart, best = self._apart(theta), math.inf
        taken, close = np.zeros_like(r), False

        def image(d: Array) -> Array:
            whole = self._adjoint(self._shares(d))
            if theta:
                whole += theta * self._program.curvature_times(d)
            whole[self._fixed] = 0.0
            return whole

        for step in steps(image, self._preconditioner(theta), r, most):
            left = math.sqrt(step.rho) * GENEROUS * apart if step.rho else 0.0
            shares = self._shares(step.e)
            own = self._fenchel(shares)
            if theta:
                curved = self._program.curvature_times(step.e)
                own += 0.5 * theta * float(step.e @ (theta * curved))
            total = max(own, 0.0) + left
            if total < best:
                best, taken = total, self._adjoint(shares)
            close = left <= max(enough, CLOSE * own)
            if close or not np.isfinite(total):
                break
        return Absorbed(best, taken, close)

    def _adjoint(self, shares: list[Array]) -> Array:
        """Σ Mᵀs, shape (n,)."""
        out = np.zeros(len(self._fixed))
        for term, s in zip(self._terms, shares, strict=True):
            out += term.matrix.T @ s
        return out

    def _shares(self, d: Array) -> list[Array]:
        """M_k d by term."""
        return [t.matrix @ d for t in self._terms]

    def _fenchel(self, shares: list[Array]) -> float:
        """The summands of the bound that depend on multipliers."""
        missing, excess = 0.0, 0.0
        for k, (term, s) in enumerate(zip(self._terms, shares, strict=True)):
            penalty, g = term.penalty, self._g[k] - s / term.weight
            t = max(penalty.gauge(g), 1.0)
            if not math.isfinite(t):
                return math.inf
            own = self._values[k] + t * penalty.conjugate(g / t)
            missing += term.weight * (own - float(g @ self._residuals[k]))
            excess = max(excess, t - 1.0)
        return missing + excess * self._objective

    def _apart(self, theta: float) -> float:
        """A bound of the norm of x − x* in Σ MᵀM + θ P."""
        f = self._objective
        square = 8.0 * theta * f  # ½ eᵀP e ≤ (√f + √f)²
        for term, r in zip(self._terms, self._residuals, strict=True):
            farthest = term.penalty.farthest(f / term.weight)
            square += (float(np.linalg.norm(r)) + farthest) ** 2
        return math.sqrt(square)

    def _preconditioner(self, theta: float) -> _Map:
        """An approximate inverse: of every field L, a network, or the diagonal."""
        diagonal = np.sum([t.column_squares() for t in self._terms], axis=0)
        for t in self._program.terms if theta else ():
            if t.is_squares and t.weight > 0.0:
                diagonal += 2.0 * theta * t.weight * t.column_squares()
        fixed = self._fixed
        inverse = np.where(
            fixed | (diagonal <= 0.0), 0.0, 1.0 / np.where(diagonal > 0, diagonal, 1.0)
        )
        fields = [
            (part, solve)
            for name, part in self._program.variables.items()
            if (solve := self._of_field(name, part)) is not None
        ]

        def precondition(v: Array) -> Array:
            z = inverse * v
            for part, solve in fields:
                z[part] = np.where(fixed[part], 0.0, solve(v[part]))
            return z

        return precondition

    def _of_field(self, name: str, part: slice) -> _Map | None:
        """A solver for one field; None for the diagonal."""
        laplace = self._program.laplace
        fixed = self._fixed[part]
        if laplace is None or len(fixed) != len(laplace.free):
            return None
        for term in self._terms:
            its_field = field_of(term, name, slice(0, len(fixed)), fixed, laplace)
            if its_field is not None:
                inverse, twice = its_field.inverse, 2.0 * term.weight
                return lambda v: twice * inverse(v, RTOL)  # (MᵀM)⁻¹ v
        for term in self._terms:
            solve = _network(term, self._program, part, fixed)
            if solve is not None:
                return solve
        return None


#: Networks by identity of their rows, a field's first column and fixed voxels; dropped
#: with the rows, so that no other object can have their identity
_networks: dict[tuple[int, int, int], _Map | None] = {}


def _network(
    term: ProgramTerm, program: Program, part: slice, fixed: Mask
) -> _Map | None:
    """The network of differences of neighbours, cached while the rows exist."""
    key = id(term.matrix), part.start, hash(fixed.tobytes())
    if key not in _networks:
        laplace, matrix = program.laplace, term.matrix[:, part]
        grid = laplace.grid
        rows = NeighbourRows.of(matrix, grid)
        links = rows.links(np.ones(matrix.shape[0]), grid.n_voxels)
        diagonal = term.column_squares()[part]
        _networks[key] = by_network(laplace, links, diagonal, fixed)
        weakref.finalize(term.matrix, _networks.pop, key, None)
    return _networks[key]
