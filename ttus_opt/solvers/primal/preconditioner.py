"""Constraint preconditioner: P for the field, the few rows D through their dual.

    P z - Dᵀy = r,    D z + E c + y = s,    Eᵀy = 0,      P⁻¹ = L̃⁻¹ Ω L̃⁻ᵀ,

is solved by S y + E c = s - D P⁻¹r with S = I + D P⁻¹ Dᵀ, then z = P⁻¹(r + Dᵀy). L̃⁻¹
is one V-cycle, a fixed linear map, and S uses the same map: an approximation of S (from
a coarser grid, say) would multiply its error by the rows' weight. Conjugate directions
of S are kept from call to call (`dual.conjugate_gradients`) and preconditioned on part
of the grid (`dual.preconditioner`), so that few are needed.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.solvers.dual.conjugate_gradients import (
    RecycledSubspace,
    conjugate_gradients,
)
from ttus_opt.solvers.dual.linear_parameters import Complement
from ttus_opt.solvers.dual.options import Accuracy, DualOptions
from ttus_opt.solvers.dual.preconditioner import schur_preconditioner
from ttus_opt.solvers.primal.approximate_system import ApproximateSystem
from ttus_opt.solvers.primal.conjugate_gradients import Pair, inner_product

#: Most directions of S whose fields P⁻¹Dᵀd are kept
MOST_FIELDS = 12

#: Part of y outside the directions' span that counts as rounding [–]
OUTSIDE = 1e-12

#: Most updates of the accuracy of S's system from the energy of its solution
ROUNDS = 3


class ConstraintPreconditioner:
    """Solves the equations above and keeps the conjugate directions of S.

    Attributes:
        complement: Multipliers with Eᵀy = 0.
    """

    def __init__(
        self,
        system: ApproximateSystem,
        columns: Array,
        inner: float,
        options: DualOptions,
    ) -> None:
        """Start without directions.

        Args:
            system: S, with approximate solves of L.
            columns: E of the free unknowns c, shape (m, k).
            inner: As in `PrimalOptions` [–].
            options: Options of the dual.
        """
        self._system, self._inner, self._options = system, inner, options
        self._responses = _Responses(system)
        self._subspace = RecycledSubspace(self._responses)
        schur = schur_preconditioner(system, options) if system.adjoint.nnz else np.copy
        self.complement = Complement(columns, schur)

    @property
    def description(self) -> str:
        """Its state in words."""
        return f"{len(self._subspace)} directions of the dual"

    def apply(self, rest: Pair) -> Pair:
        """The step (z, y) for a residual (r, s)."""
        system = self._system
        z = system.prior(rest.p)
        if not system.adjoint.nnz:
            return Pair(z, rest.y)
        side = self.complement.part(rest.y - system.measure(z))
        y = self._multipliers(side, inner_product(rest.p, z), float(rest.y @ rest.y))
        return Pair(z + self._response(y), y)

    def _response(self, y: Array) -> Array:
        """P⁻¹Dᵀy, shape (V,), from the kept fields where possible."""
        subspace, kept = self._subspace, self._responses.kept
        if len(kept) != len(subspace):
            return self._system.response(y)
        rest, out = y.copy(), np.zeros(self._system.adjoint.shape[0])
        parts, _ = subspace.parts(y)
        # directions are the normalised arguments of S
        for part, d, (of, own) in zip(parts, subspace.directions, kept, strict=True):
            share = part * float(d @ of) / float(of @ of)
            rest -= share * of
            out += share * own
        if np.linalg.norm(rest) > OUTSIDE * np.linalg.norm(y):
            return self._system.response(y)
        return out

    def _multipliers(self, side: Array, of_prior: float, of_rows: float) -> Array:
        """S⁻¹ of a right-hand side, across E, to a residual set by the step's energy.

        Args:
            side: Right-hand side, shape (m,).
            of_prior: rᵀP⁻¹r.
            of_rows: sᵀs.
        """
        y, rest = self._subspace.project(side)
        for _ in range(ROUNDS):
            energy = max(of_prior + of_rows - float(side @ y), 0.0)
            goal = self._inner * np.sqrt(energy)
            if not np.linalg.norm(self.complement.part(rest)) > goal:
                break
            args = (self._subspace, side, goal, self.complement)
            y, _ = conjugate_gradients(*args, Accuracy(0.0), self._options)
            rest = self._subspace.project(side)[1]
        return self.complement.part(y)


class _Responses:
    """S, keeping the fields of its products while there are few of them.

    Attributes:
        root_weights: As in `DualSystem`, shape (m,) [–].
        kept: Pairs of y, shape (m,), and its field P⁻¹Dᵀy, shape (V,).
    """

    def __init__(self, system: ApproximateSystem) -> None:
        self._system, self.root_weights = system, system.root_weights
        self.kept: list[tuple[Array, Array]] = []
        self._many = False

    def apply(self, y: Array, rtol: float) -> Array:
        """S y, shape (m,)."""
        own = self._system.response(y)
        self._many = self._many or len(self.kept) == MOST_FIELDS
        if self._many:
            self.kept.clear()
        else:
            self.kept.append((y, own))
        return np.asarray(y + self._system.measure(own))
