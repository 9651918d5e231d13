"""Conjugate gradients with full reorthogonalisation in a recycled subspace.

The dual is small (a few thousand rows), while each product costs two solves over all
voxels. All directions are therefore stored, and each new one is made conjugate to all
of them. Without this, conjugacy is lost to rounding when the Schur complement has
eigenvalues of 1e5 and more, and 75 steps become 150 and more. The stored subspace also
serves other right-hand sides and other weights without a solve (recycling: Parks et
al., SIAM J. Sci. Comput. 28, 2006).

Products are computed only as accurately as the residual requires, because an error in a
late, short step does little harm (Bouras and Frayssé, SIAM J. Matrix Anal. Appl. 26,
2005).
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.laplace.system import RTOL
from ttus_opt.solvers.dual.linear_parameters import Complement
from ttus_opt.solvers.dual.options import Accuracy, DualOptions

#: Directions may be stored in single precision; sums are in double
Kept = NDArray[np.floating[Any]]

#: Relative threshold below which a direction is dropped as dependent [–]
DEPENDENT = 1e-12

#: Relative residual of a solve inside a product over that of a rough dual [–]
PRODUCT = 1e-2


# Products with all directions run on one core: on vectors this short, a threaded BLAS
# that waits for a busy core takes ten times as long. Those in single precision, which
# NumPy would convert, are compiled; in double precision there are few.


def _products(rows: Kept, vector: Array) -> Array:
    """Rows @ vector."""
    if rows.dtype == vector.dtype:
        return np.asarray(np.einsum("kn,n->k", rows, vector))
    out = np.empty(len(rows))
    _set_products(out, rows, vector)
    return out


def _combination(parts: Array, rows: Kept) -> Array:
    """Parts @ rows."""
    if rows.dtype == parts.dtype:
        return np.asarray(np.einsum("k,kn->n", parts, rows))
    out = np.zeros(rows.shape[1])
    _add_combination(out, parts, rows)
    return out


@compiled(nogil=True, fastmath={"contract", "reassoc"})
def _set_products(out: Array, rows: Kept, vector: Array) -> None:
    for k in range(len(rows)):
        row, total = rows[k], 0.0
        for n in range(row.size):
            total += row[n] * vector[n]
        out[k] = total


@compiled(nogil=True, fastmath={"contract", "reassoc"})
def _add_combination(out: Array, parts: Array, rows: Kept) -> None:
    for k in range(len(rows)):
        row, part = rows[k], parts[k]
        for n in range(row.size):
            out[n] += part * row[n]


class DualOperator(Protocol):
    """A Schur complement S, symmetric positive definite."""

    @property
    def root_weights(self) -> Array:
        """Roots of the rows' weights, shape (m,) [–]."""

    def apply(self, y: Array, rtol: float) -> Array:
        """S y to a relative accuracy, shape (m,)."""


class RecycledSubspace:
    """Conjugate directions of one operator, growing as right-hand sides ask for them.

    With d normalised, S d is kept beside it. A change of the weights w² makes the
    directions conjugate again without a solve: w d and (S - I) d / w do not depend on
    the weights.
    """

    def __init__(
        self, system: DualOperator, kept_as: type[np.floating[Any]] = np.float64
    ) -> None:
        """Start without directions.

        Args:
            system: The operator.
            kept_as: Precision in which directions are stored.
        """
        self.system = system
        #: Directions and their images, with space for more, shape (2, k, m)
        self._store: Kept = np.empty((2, 16, len(system.root_weights)), kept_as)
        self._count = 0

    def __len__(self) -> int:
        """Number of directions."""
        return self._count

    @property
    def _kept(self) -> tuple[Kept, Kept]:
        """Directions d and their images S d, shape (k, m) each."""
        return self._store[0, : self._count], self._store[1, : self._count]

    @property
    def directions(self) -> Kept:
        """All directions, shape (k, m)."""
        return self._kept[0]

    def parts(self, y: Array) -> tuple[Array, Array]:
        """Coefficients of y in the directions, shape (k,), and the rest, (m,)."""
        d, images = self._kept
        parts, rest = np.zeros(len(d)), y
        for _ in range(2):  # after rough products d is only nearly conjugate
            more = _products(images, rest)
            parts, rest = parts + more, rest - _combination(more, d)
        return parts, rest

    def adopt(self, system: DualOperator) -> None:
        """Change to a system with other weights of the same rows, without a solve."""
        ratio = system.root_weights / self.system.root_weights
        self.system = system
        old, images = self._kept
        d = old / ratio
        image = d + (images - old) * ratio
        gram = d @ image.T
        size, turn = np.linalg.eigh((gram + gram.T) / 2.0)
        keep = size > DEPENDENT * size.max(initial=0.0)
        mix = (turn[:, keep] / np.sqrt(size[keep])).T
        self._count = len(mix)
        self._store = np.empty((2, max(16, self._count), d.shape[1]), old.dtype)
        self._store[:, : self._count] = mix @ d, mix @ image

    def project(self, right_side: Array) -> tuple[Array, Array]:
        """The best y in the subspace, and its residual.

        Args:
            right_side: Shape (m,).

        Returns:
            y and right_side - S y, shape (m,) each.
        """
        d, images = self._kept
        parts = _products(d, right_side)
        return _combination(parts, d), right_side - _combination(parts, images)

    def step(self, right_side: Array) -> tuple[Array, Array]:
        """`project` onto the last direction only, if there is one."""
        if not self._count:
            return np.zeros_like(right_side), right_side
        d, image = (rows[-1].astype(float) for rows in self._kept)
        part = float(d @ right_side)
        return part * d, right_side - part * image

    def extend(self, direction: Array, rtol: float) -> bool:
        """Make a direction conjugate to the others, normalise and store it.

        Args:
            direction: Shape (m,).
            rtol: Relative residual of the solves in its product.

        Returns:
            False if rounding leaves no direction, as for weights so large that I is
            lost in S.
        """
        d, images = self._kept
        for _ in range(2):  # once is not enough where S is large
            parts = _products(images, direction)
            direction = direction - _combination(parts, d)
        if not np.isfinite(direction).all():
            return False
        image = self.system.apply(direction, rtol)
        square = float(direction @ image)
        if not (np.isfinite(square) and square > 0.0):
            return False
        if self._count == self._store.shape[1]:
            self._store = np.concatenate([self._store, self._store], axis=1)
        root = np.sqrt(square)  # divide before rounding: an image may be huge
        self._store[:, self._count] = direction / root, image / root
        self._count += 1
        return True


def conjugate_gradients(
    subspace: RecycledSubspace,
    right_side: Array,
    goal: float,
    space: Complement,
    accuracy: Accuracy,
    options: DualOptions,
) -> tuple[Array, int]:
    """Solve S y = right_side in a complement until ‖part of the residual‖ ≤ goal.

    Args:
        subspace: Known directions; extended by this solve.
        right_side: Shape (m,).
        goal: Norm of the residual at which to stop.
        space: The complement that contains y and in which the residual counts.
        accuracy: Accuracy of the dual, and the deadline.
        options: Options of the solver.

    Returns:
        y, shape (m,), and the number of new directions. The caller verifies whether the
        goal was reached.
    """
    y, residual = subspace.project(right_side)
    loosest = max(options.loosest_product, PRODUCT * accuracy.rtol)
    steps = 0
    best, least = np.zeros_like(y), float(np.linalg.norm(right_side))
    while True:
        residual = space.part(residual)
        size = float(np.linalg.norm(residual))
        if size <= goal or steps == options.max_directions or accuracy.late:
            return y, steps
        if size < least:
            best, least = y, size
        rtol = min(max(0.1 * goal / size, RTOL), loosest)
        diverged = not size <= options.divergence * least
        if diverged or not subspace.extend(space.precondition(residual), rtol):
            return best, steps
        # onto all directions, since inexact images leave a rest on each of them
        step, residual = subspace.project(residual)
        y, steps = y + step, steps + 1
