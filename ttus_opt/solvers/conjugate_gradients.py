"""Conjugate gradients, the one loop of all solvers here.

For H y = t, with H symmetric and positive definite, it repeats

    z ≈ H⁻¹r,   d = z conjugate to earlier directions,   y ← y + α d,   r = t - H y.

Preconditioners vary slightly from step to step, so that conjugacy does not follow by
itself: it is made with the images H d that are kept (flexible conjugate gradients:
Notay, SIAM J. Sci. Comput. 22, 2000).

- `LastDirection` keeps one, for vectors over all voxels.
- `RecycledSubspace` keeps all, for duals of a few thousand rows whose products cost two
  solves over all voxels. Without this, conjugacy is lost to rounding when S has
  eigenvalues of 1e5 and more, and 75 steps become 150 and more. The subspace also
  serves other right-hand sides and other weights without a product (recycling: Parks et
  al., SIAM J. Sci. Comput. 28, 2006).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.solvers.base import is_late

Map = Callable[[Array], Array]

#: Relative threshold below which a direction is dropped as dependent [–]
DEPENDENT = 1e-12

#: If a residual has grown by this factor, the preconditioner has failed: growth by the
#: square root of the condition number, 1e5 at weights of 1e6, is normal [–]
DIVERGENCE = 1e6


@dataclass(frozen=True)
class Run:
    """End of a run; the caller decides whether it is enough.

    Attributes:
        y: Shape (n,).
        rest: Its residual, shape (n,).
        steps: New directions [–].
    """

    y: Array = field(repr=False)
    rest: Array = field(repr=False)
    steps: int


def conjugate_gradients(
    directions: LastDirection | RecycledSubspace,
    right_side: Array,
    precondition: Callable[[Array], Array | None],
    enough: Callable[[Array, Array], bool],
    most: int,
    rtol: Callable[[Array], float] = lambda rest: 0.0,
) -> Run:
    """Solve H y = right_side.

    Args:
        directions: Directions of H; extended.
        right_side: Shape (n,).
        precondition: r ↦ about H⁻¹ r in a new array; None to stop.
        enough: Whether to stop at y and its residual.
        most: Most steps [–].
        rtol: Relative accuracy of the next product at a residual: an error in a late,
            short step does little harm (Bouras and Frayssé, SIAM J. Matrix Anal. Appl.
            26, 2005).
    """
    y, rest = directions.project(right_side)
    steps, best, least = 0, (np.zeros_like(y), right_side), norm(right_side)
    while not enough(y, rest) and steps < most:
        size = norm(rest)
        if size < least:
            best, least = (y, rest), size
        direction = precondition(rest)
        if direction is None:
            break
        if not size <= DIVERGENCE * least or not directions.extend(
            direction, rtol(rest)
        ):
            return Run(*best, steps)
        step, rest = directions.project(rest)
        y, steps = y + step, steps + 1
    return Run(y, rest, steps)


def inner_product(a: Array, b: Array) -> float:
    """Σ a b on one core; a threaded BLAS is slower while the cores are busy."""
    return float(np.einsum("i,i", a, b))


def norm(a: Array) -> float:
    """Euclidean norm, on one core."""
    return math.sqrt(inner_product(a, a))


class LastDirection:
    """The last direction alone (Polak and Ribière's rule)."""

    def __init__(
        self,
        product: Map,
        pairing: Callable[[Array, Array], float] = inner_product,
    ) -> None:
        """Start without one.

        Args:
            product: d ↦ H d, in a new array.
            pairing: Inner product of a residual and a direction.
        """
        self._product, self._pairing = product, pairing
        self._kept: tuple[Array, Array, float] | None = None

    def project(self, right_side: Array) -> tuple[Array, Array]:
        """The best multiple of the direction, and its residual."""
        if self._kept is None:
            return np.zeros_like(right_side), right_side
        direction, image, curvature = self._kept
        part = self._pairing(right_side, direction) / curvature
        return part * direction, right_side - part * image

    def extend(self, direction: Array, rtol: float) -> bool:
        """Replace it by a new one, conjugate to it where that adds a part of it.

        Returns:
            False if nothing is left of it.
        """
        if self._kept is not None:
            last, image, curvature = self._kept
            part = -self._pairing(image, direction) / curvature
            direction = direction + max(part, 0.0) * last
        image = self._product(direction)
        curvature = self._pairing(image, direction)
        if not (np.isfinite(curvature) and curvature > 0.0):
            return False
        self._kept = direction, image, curvature
        return True


def to_residual(
    product: Map,
    right_side: Array,
    precondition: Map,
    rtol: float,
    most: int,
    deadline: float | None,
) -> Run:
    """Solve H y = right_side over long vectors, to a relative residual.

    Args:
        product: d ↦ H d, in a new array.
        right_side: Shape (n,).
        precondition: r ↦ about H⁻¹ r, in a new array.
        rtol: Relative residual to reach [–].
        most: Most steps [–].
        deadline: `time.perf_counter` at which to stop; None for never [s].
    """
    goal = rtol * norm(right_side)

    def enough(y: Array, rest: Array) -> bool:
        return is_late(deadline) or norm(rest) <= goal

    directions = LastDirection(product)
    return conjugate_gradients(directions, right_side, precondition, enough, most)


# Products with all directions run on one core: on vectors this short, a threaded BLAS
# that waits for a busy core takes ten times as long.


def _products(rows: Array, vector: Array) -> Array:
    """Rows @ vector."""
    return np.asarray(np.einsum("kn,n->k", rows, vector))


def _combination(parts: Array, rows: Array) -> Array:
    """Parts @ rows."""
    return np.asarray(np.einsum("k,kn->n", parts, rows))


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

    def __init__(self, system: DualOperator) -> None:
        """Start without directions of an operator."""
        self.system = system
        #: Directions and their images, with space for more, shape (2, k, m)
        self._store = np.empty((2, 16, len(system.root_weights)))
        self._count = 0

    def __len__(self) -> int:
        """Number of directions."""
        return self._count

    @property
    def _kept(self) -> tuple[Array, Array]:
        """Directions d and their images S d, shape (k, m) each."""
        return self._store[0, : self._count], self._store[1, : self._count]

    @property
    def directions(self) -> Array:
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
        self._store = np.empty((2, max(16, self._count), d.shape[1]))
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
        root = np.sqrt(square)
        self._store[:, self._count] = direction / root, image / root
        self._count += 1
        return True
