"""Iterative refinement: residuals and the solution in double precision.

Corrections are found in single precision (N. J. Higham, Accuracy and Stability of
Numerical Algorithms, 2002, chapter 12). Here are the parts in double precision, on
whole grids of voxels in C order, and the ways to and from the red-black order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array, IntArray
from ttus_opt.compiled import compiled
from ttus_opt.multigrid.coarsening import Grounds
from ttus_opt.multigrid.kernels import FAST
from ttus_opt.multigrid.red_black import Single
from ttus_opt.voxmap.grid import flat_index


class Operator(NamedTuple):
    """A on the grid.

    Attributes:
        free: Unknown voxels, shape (V,).
        r: Conductances to the next layer, shape (n_r,) [m].
        t: Conductances to the next spoke, shape (n_r,) [m].
        z: Conductances to the next slice, shape (n_r,) [m].
        own: What else the diagonal has, shape (n_r,) [m].
        cut: Voxels with other grounds than an even grid's, ascending, shape (k,).
        cut_grounds: What their diagonal has more for it, shape (k,) [m].
        cut_layers: Where each layer's begin among them, shape (n_r + 1,).
        n_theta: Spokes [–].
        n_z: Slices [–].
        pitch: Of the red-black order [–].
    """

    free: NDArray[np.bool_]
    r: Array
    t: Array
    z: Array
    own: Array
    cut: IntArray
    cut_grounds: Array
    cut_layers: IntArray
    n_theta: int
    n_z: int
    pitch: int

    @classmethod
    def of(
        cls,
        free: NDArray[np.bool_],
        conductances: tuple[Array, Array, Array],
        sizes: tuple[int, int, int],
        own: Array | None = None,
        grounds: Grounds | None = None,
    ) -> Operator:
        """A on a grid.

        Args:
            free: Unknown voxels, shape (V,).
            conductances: Along r, θ and z, shape (n_r,) each [m].
            sizes: Spokes, slices and pitch [–].
            own: What else the diagonal has, shape (n_r,) [m]; None for nothing.
            grounds: What cut links change; None for nothing.
        """
        n_r = len(conductances[0])
        own = np.zeros(n_r) if own is None else own
        if grounds is None:
            grounds = Grounds(np.zeros(0, np.int64), np.zeros((0, 3)))
        cut = grounds.where(free)
        starts = np.arange(n_r + 1) * (sizes[0] * sizes[1])
        return cls(
            free,
            *conductances,
            own,
            cut.voxels,
            cut.changes.sum(axis=1),
            np.searchsorted(cut.voxels, starts),
            *sizes,
        )


class _Starts(NamedTuple):
    """Where voxels in a row begin, and their neighbours across it."""

    out: np.uint64
    own: np.uint64
    inner: np.uint64
    outer: np.uint64
    before: np.uint64
    after: np.uint64


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_operate(
    out: Array, x: Array, at: _Starts, i: int, a: Operator, count: np.uint64
) -> None:
    """A x in a row of voxels of layer i (compiled)."""
    r_in, r_out, t, z = a.r[i - 1], a.r[i], a.t[i], a.z[i]
    diagonal, one = r_in + r_out + 2.0 * t + 2.0 * z + a.own[i], np.uint64(1)
    for n in range(count):
        value = diagonal * x[at.own + n] - r_in * x[at.inner + n]
        value -= r_out * x[at.outer + n] + t * (x[at.before + n] + x[at.after + n])
        out[at.out + n] = value - z * (x[at.own + n - one] + x[at.own + n + one])


@compiled(inner=True, nogil=True)
def _layer(out: Array, start: int, x: Array, i: int, a: Operator) -> None:
    """A x in layer i, with nonsense in the first and last slice (compiled).

    Args:
        out: Result.
        start: Where it begins there.
        x: Values, zero at fixed voxels, shape (V,).
        i: Neither the first nor the last layer.
        a: The operator.
    """
    n_z, ring = a.n_z, a.n_theta * a.n_z
    layer = flat_index(i, 0, 0, a.n_theta, n_z)
    # the spokes next to the seam on their own
    for low, high in ((0, n_z), (n_z, ring - n_z), (ring - n_z, ring)):
        own = layer + low
        at = _Starts(
            np.uint64(start + low),
            np.uint64(own),
            np.uint64(own - ring),
            np.uint64(own + ring),
            np.uint64(own - n_z if low > 0 else layer + ring - n_z),
            np.uint64(own + n_z if high < ring else layer),
        )
        _row_operate(out, x, at, i, a, np.uint64(high - low))
    for n in range(a.cut_layers[i], a.cut_layers[i + 1]):
        out[start + a.cut[n] - layer] += a.cut_grounds[n] * x[a.cut[n]]


@compiled(nogil=True)
def operate(out: Array, x: Array, a: Operator) -> None:
    """A x (compiled).

    Args:
        out: Result, shape (V,); zero at fixed voxels.
        x: Values, zero at fixed voxels, shape (V,).
        a: The operator.
    """
    for i in range(1, a.r.size - 1):
        _layer(out, flat_index(i, 0, 0, a.n_theta, a.n_z), x, i, a)
    for n in range(out.size):
        out[n] = out[n] if a.free[n] else 0.0


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_residual(
    line: Array, b: Array, free: NDArray[np.bool_], start: int, known: float
) -> float:
    """Turn A x of a layer into b - known · A x; returns its square (compiled)."""
    total, first = 0.0, np.uint64(start)
    for k in range(np.uint64(line.size)):
        value = b[first + k] - known * line[k] if free[first + k] else 0.0
        line[k] = value
        total += value * value
    return total


def residual(
    out: Single, x: Array, b: Array, a: Operator, scale: float, is_zero: bool
) -> float:
    """Residual b - A x, scaled, in red-black order.

    Args:
        out: Result in single precision, shape (2, n_r, width).
        x: Values, zero at fixed voxels, shape (V,).
        b: Right-hand side, shape (V,).
        a: The operator.
        scale: Factor of ``out`` [–].
        is_zero: Whether to take x for zero, whatever is there.

    Returns:
        Sum of the squared residuals, unscaled.
    """
    layer = np.zeros(a.n_theta * a.n_z)  # here: to compile it takes half a second
    return float(_set_residual(out, layer, x, b, a, scale, is_zero))


@compiled(nogil=True)
def _set_residual(
    out: Single,
    layer: Array,
    x: Array,
    b: Array,
    a: Operator,
    scale: float,
    is_zero: bool,
) -> float:
    """`residual`, in whose scratch space layers lie one by one (compiled)."""
    total = 0.0
    for i in range(1, a.r.size - 1):
        if not is_zero:
            _layer(layer, 0, x, i, a)
        start = flat_index(i, 0, 0, a.n_theta, a.n_z)
        total += _row_residual(layer, b, a.free, start, 0.0 if is_zero else 1.0)
        for j in range(a.n_theta):
            for odd in range(2):
                m = (j + 1) * a.pitch + 1 + odd
                row, place = out[m & 1, i], np.uint64(m >> 1)
                first = np.uint64(j * a.n_z + 1 + odd)
                for n in range(np.uint64((a.n_z - 1 - odd) // 2)):
                    row[place + n] = scale * layer[first + n + n]
    return total


@compiled(nogil=True, fastmath=FAST)
def add(
    x: Array, correction: Single, scale: float, n_theta: int, n_z: int, pitch: int
) -> float:
    """Correct x by scale · correction; returns the sum of the new x² (compiled).

    Args:
        x: Values, shape (V,).
        correction: In red-black order, zero at fixed voxels, shape (2, n_r, width).
        scale: Factor [–].
        n_theta: Spokes [–].
        n_z: Slices [–].
        pitch: Of the red-black order [–].
    """
    total = 0.0
    for i in range(1, correction.shape[1] - 1):
        for j in range(n_theta):
            own = flat_index(i, j, 0, n_theta, n_z)
            for odd in range(2):
                m = (j + 1) * pitch + 1 + odd
                row, place = correction[m & 1, i], np.uint64(m >> 1)
                first = np.uint64(own + 1 + odd)
                for n in range(np.uint64((n_z - 1 - odd) // 2)):
                    value = x[first + n + n] + scale * row[place + n]
                    x[first + n + n] = value
                    total += value * value
    return total
