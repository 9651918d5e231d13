"""A few unknown parameters c beside the field, with columns E in the measured rows.

With D p + E c = t, the multipliers y and the free parameters satisfy

    S y + E c = t - D p₀,   Eᵀy = 0.

Conjugate gradients in the orthogonal complement of E's columns solve both at once: the
remaining residual lies along E and equals E c (projected, or null-space, conjugate
gradients: Gould, Hribar and Nocedal, SIAM J. Sci. Comput. 23, 2001). Eliminating with
the Schur complement EᵀS⁻¹E would cost one more solve per column, and c would be
inaccurate where S⁻¹E is small compared with E.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.solvers.conjugate_gradients import (
    RecycledSubspace,
    Run,
    conjugate_gradients,
    norm,
)

#: Relative threshold for a column that depends on others [–]
DEPENDENT = 1e-12

#: Relative threshold for a zero slope of the objective in c [–]
FLAT = 1e-10


@dataclass(frozen=True)
class LinearParameters:
    """Unknown parameters beside the field.

    Attributes:
        columns: E, with the rows' weights, shape (m, k).
        lower: Lower bounds of c, shape (k,).
        upper: Upper bounds of c, shape (k,).
    """

    columns: Array = field(repr=False)
    lower: Array
    upper: Array

    @classmethod
    def none(cls, n_rows: int) -> LinearParameters:
        """No parameters."""
        return cls(np.zeros((n_rows, 0)), np.zeros(0), np.zeros(0))

    @cached_property
    def moving(self) -> Mask:
        """Which parameters affect a measurement, shape (k,)."""
        return np.asarray(self.columns.any(axis=0))

    def between(self, c: Array) -> Mask:
        """Which of these lie strictly between their bounds, shape (k,)."""
        return self.moving & (self.lower < c) & (c < self.upper)

    def clipped(self, c: Array) -> Array:
        """The nearest values within the bounds, shape (k,)."""
        return np.clip(c, self.lower, self.upper)

    def violating(self, c: Array, y: Array, free: Mask) -> Mask:
        """Free parameters beyond a bound, and bounds with the wrong multiplier sign.

        Args:
            c: Values, shape (k,).
            y: Multipliers of the measured rows, shape (m,).
            free: Which parameters were free, shape (k,).
        """
        slope = self.columns.T @ y
        flat = FLAT * np.linalg.norm(self.columns, axis=0) * np.linalg.norm(y)
        held_back = (c < self.upper) & (slope > flat)
        held_back |= (c > self.lower) & (slope < -flat)
        beyond = (c < self.lower) | (c > self.upper)
        return np.asarray(np.where(free, beyond, self.moving & held_back))


class Complement:
    """The orthogonal complement of E's columns, and the coefficients along them."""

    def __init__(self, columns: Array, schur: Callable[[Array], Array]) -> None:
        """Decompose the columns.

        Args:
            columns: E of the free parameters, shape (m, k); k may be 0.
            schur: An approximation of S⁻¹.
        """
        U, size, V = np.linalg.svd(columns, full_matrices=False)
        kept = size > DEPENDENT * size.max(initial=0.0)
        self._basis = U[:, kept]
        self._inverse = V[kept].T / size[kept] @ self._basis.T
        self._schur = schur

    def part(self, residual: Array) -> Array:
        """The part orthogonal to E, shape (m,)."""
        return np.asarray(residual - self._basis @ (self._basis.T @ residual))

    def coefficients(self, residual: Array) -> Array:
        """The smallest c with E c closest to a residual, shape (k,)."""
        return np.asarray(self._inverse @ residual)

    def precondition(self, residual: Array) -> Array:
        """Approximately S⁻¹ on the complement of E, shape (m,)."""
        z, made = self._schur(residual), self._made
        inner = self._basis.T @ made
        return np.asarray(z - made @ np.linalg.solve(inner, self._basis.T @ z))

    def solve(
        self,
        subspace: RecycledSubspace,
        right_side: Array,
        goal: Callable[[Array], float],
        most: int,
        rtol: Callable[[float], float] = lambda size: 0.0,
        late: Callable[[], bool] = lambda: False,
    ) -> Run:
        """Solve S y = right_side on the complement by conjugate gradients.

        Args:
            subspace: Directions of S; extended.
            right_side: In the complement, shape (m,).
            goal: Norm of the residual's part in the complement at which to stop at y.
            most: Most new directions [–].
            rtol: Accuracy of a product at such a norm [–].
            late: Whether to stop now.
        """

        def size(rest: Array) -> float:
            return norm(self.part(rest))

        return conjugate_gradients(
            subspace,
            right_side,
            lambda rest: self.precondition(self.part(rest)),
            lambda y, rest: size(rest) <= goal(y) or late(),
            most,
            lambda rest: rtol(size(rest)),
        )

    @cached_property
    def _made(self) -> Array:
        """Approximately S⁻¹ times the basis, shape (m, k)."""
        made = [self._schur(column) for column in self._basis.T]
        return np.array(made).reshape(-1, len(self._basis)).T
