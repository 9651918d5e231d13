"""Constraint preconditioner: any P for the field, few rows D through their dual.

    P z - Dᵀy = r,    D z + E c + y = s,    Eᵀy = 0,

is solved by S y + E c = s - D P⁻¹r with S = I + D P⁻¹ Dᵀ, then z = P⁻¹(r + Dᵀy). P⁻¹
is a fixed linear map, such as one V-cycle for each L̃⁻¹, and S uses the same map: an
approximation of S (from a coarser grid, say) would multiply its error by the rows'
weight. Conjugate directions of S are kept from call to call, so that few are needed.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.solvers.conjugate_gradients import (
    Map,
    RecycledSubspace,
    inner_product,
    norm,
)
from ttus_opt.solvers.dual.linear_parameters import Complement
from ttus_opt.solvers.dual.preconditioner import SchurPreconditioner
from ttus_opt.solvers.dual.system import DualSystem, SchurComplement

#: Most directions of S whose fields P⁻¹Dᵀd are kept
MOST_FIELDS = 12

#: Part of y outside the directions' span that counts as rounding [–]
OUTSIDE = 1e-12

#: Most directions of S
MOST = 2000

#: Residual of S's system over the energy norm of its solution [–]
INNER = 0.1


class ConstraintPreconditioner:
    """Solves the equations above and keeps the conjugate directions of S.

    Attributes:
        complement: Multipliers with Eᵀy = 0.
    """

    def __init__(
        self,
        system: SchurComplement,
        columns: Array | None = None,
        inner: float = INNER,
    ) -> None:
        """Start without directions.

        Args:
            system: S over P.
            columns: E of the free unknowns c, shape (m, k); None for none.
            inner: Residual of S's system over the energy norm of its solution [–].
        """
        self._system, self._inner = system, inner
        self._responses = _Responses(system)
        self._subspace = RecycledSubspace(self._responses)
        schur: Map = np.copy
        if isinstance(system, DualSystem) and system.adjoint.nnz:
            schur = SchurPreconditioner(system)
        if columns is None:
            columns = np.zeros((len(system.root_weights), 0))
        self.complement = Complement(columns, schur)

    @property
    def description(self) -> str:
        """Its state in words."""
        return f"{len(self._subspace)} directions of the dual"

    def __call__(self, rest: Array) -> Array:
        """The step (z, y) for a residual (r, s), shape (V + m,)."""
        r, s = np.split(rest, [len(rest) - len(self._system.root_weights)])
        return np.concatenate(self._step(r, s))

    def field(self, r: Array) -> Array:
        """Z for r and s = 0: (P + DᵀD)⁻¹ r by Woodbury's formula, shape (V,)."""
        return self._step(r, np.zeros_like(self._system.root_weights))[0]

    def _step(self, r: Array, s: Array) -> tuple[Array, Array]:
        system = self._system
        z = system.prior(r)
        if not system.adjoint.nnz:
            return z, s
        side = self.complement.part(s - system.measure(z))
        of_both = inner_product(r, z) + float(s @ s)

        def goal(y: Array) -> float:
            return self._inner * math.sqrt(max(of_both - float(side @ y), 0.0))

        y = self.complement.solve(self._subspace, side, goal, MOST).y
        y = self.complement.part(y)
        return z + self._response(y), y

    def _response(self, y: Array) -> Array:
        """P⁻¹Dᵀy, shape (V,), from the kept fields where possible."""
        subspace, kept = self._subspace, self._responses.kept
        parts, rest = subspace.parts(y)
        if len(kept) != len(subspace) or norm(rest) > OUTSIDE * norm(y):
            return self._system.response(y)
        out = np.zeros(self._system.rows.shape[1])
        # directions are the normalised arguments of S
        for part, d, (size, own) in zip(parts, subspace.directions, kept, strict=True):
            out += part * norm(d) / size * own
        return out


class _Responses:
    """S, keeping the fields of its products while there are few of them.

    Attributes:
        root_weights: As in `SchurComplement`, shape (m,) [–].
        kept: Norm of a y and its field P⁻¹Dᵀy, shape (V,).
    """

    def __init__(self, system: SchurComplement) -> None:
        self._system, self.root_weights = system, system.root_weights
        self.kept: list[tuple[float, Array]] = []
        self._many = False

    def apply(self, y: Array, rtol: float) -> Array:
        """S y, shape (m,)."""
        own = self._system.response(y)
        self._many = self._many or len(self.kept) == MOST_FIELDS
        if self._many:
            self.kept.clear()
        else:
            self.kept.append((norm(y), own))
        return np.asarray(y + self._system.measure(own))


def with_few_rows(prior: Map, rows: sp.csr_array) -> Map:
    """(P + DᵀD)⁻¹ from P⁻¹, approximately.

    Args:
        prior: P⁻¹, linear.
        rows: D, shape (m, n).
    """
    system = SchurComplement(prior, rows, np.ones(rows.shape[0]))
    return ConstraintPreconditioner(system).field
