"""Iterative refinement: residuals and the solution in double precision.

Corrections are found in single precision (N. J. Higham, Accuracy and Stability of
Numerical Algorithms, 2002, chapter 12). Here are the parts in double precision, on
whole grids of voxels in C order, and the ways to and from the red-black order.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.compiled import compiled
from ttus_opt.core.threads import in_parts
from ttus_opt.laplace.multigrid.coarsening import Grounds
from ttus_opt.laplace.multigrid.kernels import FAST, Part, bounds
from ttus_opt.laplace.multigrid.red_black import Single
from ttus_opt.voxmap.grid import flat_index


class Operator(NamedTuple):
    """A on the grid.

    Attributes:
        free: Unknown voxels, shape (V,).
        layers: Per layer the conductances to the layers before and after, to the next
            spoke and to the next slice, and the diagonal, shape (n_r, 5) [m].
        cut: Voxels with cut links, ascending, shape (k,).
        cut_grounds: What these add to the diagonal, shape (k,) [m].
        cut_layers: Offset of each layer's among them, shape (n_r + 1,).
        n_theta: Spokes [–].
        n_z: Slices [–].
        pitch: Pitch of the red-black order [–].
    """

    free: NDArray[np.bool_]
    layers: Array
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
            own: Screening on the diagonal, shape (n_r,) [m]; None for nothing.
            grounds: Corrections of cut links; None for nothing.
        """
        n_r = len(conductances[0])
        own = np.zeros(n_r) if own is None else own
        r, t, z = conductances
        before = np.roll(r, 1)  # the first layer's is not read
        diagonal = before + r + 2.0 * t + 2.0 * z + own
        if grounds is None:
            grounds = Grounds(np.zeros(0, np.int64), np.zeros((0, 3)))
        cut = grounds.where(free)
        starts = np.arange(n_r + 1) * (sizes[0] * sizes[1])
        return cls(
            free,
            np.stack([before, r, t, z, diagonal], axis=1),
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


class _Weights(NamedTuple):
    """A row of `Operator.layers`."""

    inner: float
    outer: float
    theta: float
    z: float
    diagonal: float


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_operate(
    out: Array, x: Array, at: _Starts, by: _Weights, count: np.uint64
) -> None:
    """A x in a row of voxels of one layer (compiled)."""
    one = np.uint64(1)
    for n in range(count):
        own = at.own + n
        value = by.diagonal * x[own] - by.inner * x[at.inner + n]
        value -= by.outer * x[at.outer + n]
        value -= by.theta * (x[at.before + n] + x[at.after + n])
        out[at.out + n] = value - by.z * (x[own - one] + x[own + one])


@compiled(inner=True, nogil=True)
def _layer(out: Array, start: int, x: Array, i: int, a: Operator) -> None:
    """A x in layer i, undefined in the first and last slice (compiled).

    Args:
        out: Result.
        start: Where it begins there.
        x: Values, zero at fixed voxels, shape (V,).
        i: Neither the first nor the last layer.
        a: The operator.
    """
    n_z, ring, by = a.n_z, a.n_theta * a.n_z, a.layers
    layer = flat_index(i, 0, 0, a.n_theta, n_z)
    weights = _Weights(by[i, 0], by[i, 1], by[i, 2], by[i, 3], by[i, 4])
    for part in range(3):  # the spokes next to the seam on their own
        low = 0 if part == 0 else (n_z if part == 1 else ring - n_z)
        high = n_z if part == 0 else (ring - n_z if part == 1 else ring)
        own = layer + low
        at = _Starts(
            np.uint64(start + low),
            np.uint64(own),
            np.uint64(own - ring),
            np.uint64(own + ring),
            np.uint64(own - n_z if part else layer + ring - n_z),
            np.uint64(layer if part == 2 else own + n_z),
        )
        _row_operate(out, x, at, weights, np.uint64(high - low))
    cut, grounds = a.cut, a.cut_grounds
    for n in range(a.cut_layers[i], a.cut_layers[i + 1]):
        out[start + cut[n] - layer] += grounds[n] * x[cut[n]]


@compiled(nogil=True)
def operate(out: Array, x: Array, a: Operator, part: Part) -> None:
    """A x (compiled).

    Args:
        out: Result, shape (V,); zero at fixed voxels.
        x: Values, zero at fixed voxels, shape (V,).
        a: The operator.
        part: Range of layers.
    """
    low, high = bounds(0, len(a.layers), part)
    for i in range(low, high):
        start = flat_index(i, 0, 0, a.n_theta, a.n_z)
        if 0 < i < len(a.layers) - 1:
            _layer(out, start, x, i, a)
        for n in range(start, start + a.n_theta * a.n_z):
            out[n] = out[n] if a.free[n] else 0.0


def residual(
    out: Single,
    x: Array,
    b: Array,
    a: Operator,
    scale: float,
    *,
    is_zero: bool = False,
    parts: int = 1,
) -> float:
    """Residual b - A x, scaled, in red-black order.

    Args:
        out: Result in single precision, shape (2, n_r, width).
        x: Values, zero at fixed voxels, shape (V,).
        b: Right-hand side, shape (V,).
        a: The operator.
        scale: Factor of ``out`` [–].
        is_zero: Whether x counts as zero, whatever it holds.
        parts: How many cores share it.

    Returns:
        Sum of the squared residuals, unscaled.
    """
    flat, sums = out.reshape(-1, copy=False), np.zeros(len(a.layers))
    factors = float(scale), 0.0 if is_zero else 1.0

    def work(part: Part) -> None:
        layer = np.zeros(a.n_theta * a.n_z)  # here: to compile it takes half a second
        _set_residual(flat, layer, x, b, a, factors, sums, part)

    in_parts(work, parts)
    return math.fsum(sums)


@compiled(nogil=True, fastmath=FAST)
def _set_residual(
    out: Single,
    layer: Array,
    x: Array,
    b: Array,
    a: Operator,
    factors: tuple[float, float],
    sums: Array,
    part: Part,
) -> None:
    """`residual`, in whose scratch space layers lie one by one (compiled)."""
    n_r, free, (scale, known) = len(a.layers), a.free, factors
    width = out.size // (2 * n_r)
    low, high = bounds(1, n_r - 1, part)
    for i in range(low, high):
        total = 0.0
        if known != 0.0:
            _layer(layer, 0, x, i, a)
        start = np.uint64(flat_index(i, 0, 0, a.n_theta, a.n_z))
        for n in range(np.uint64(layer.size)):
            value = b[start + n] - known * layer[n] if free[start + n] else 0.0
            layer[n] = value
            total += value * value
        sums[i] = total
        for half in range(2 * a.n_theta):  # of each spoke the odd slices, then the even
            j, odd = half >> 1, half & 1
            m = (j + 1) * a.pitch + 1 + odd
            place = np.uint64(((m & 1) * n_r + i) * width + (m >> 1))
            first = np.uint64(j * a.n_z + 1 + odd)
            for n in range(np.uint64((a.n_z - 1 - odd) // 2)):
                out[place + n] = scale * layer[first + n + n]


def add(
    x: Array,
    correction: Single,
    scale: float,
    a: Operator,
    *,
    parts: int = 1,
) -> float:
    """Correct x by scale · correction; returns the sum of the new x².

    Args:
        x: Values, shape (V,).
        correction: In red-black order, zero at fixed voxels, shape (2, n_r, width).
        scale: Factor [–].
        a: The operator.
        parts: How many cores share it.
    """
    _, n_r, width = correction.shape
    flat = correction.reshape(-1, copy=False)
    sums = np.zeros(n_r)
    sizes = (a.n_theta, a.n_z, a.pitch, width)
    in_parts(partial(add_flat, x, flat, scale, sums, sizes), parts)
    return math.fsum(sums)


@compiled(nogil=True, fastmath=FAST)
def add_flat(
    x: Array,
    correction: Single,
    scale: float,
    sums: Array,
    sizes: tuple[int, int, int, int],
    part: Part,
) -> None:
    """`add`, the correction flat, ``sizes`` with the width of its order (compiled)."""
    (n_theta, n_z, pitch, width), n_r = sizes, sums.size
    low, high = bounds(1, n_r - 1, part)
    for i in range(low, high):
        total = 0.0
        layer = flat_index(i, 0, 0, n_theta, n_z)
        for half in range(2 * n_theta):
            j, odd = half >> 1, half & 1
            m = (j + 1) * pitch + 1 + odd
            place = np.uint64(((m & 1) * n_r + i) * width + (m >> 1))
            first = np.uint64(layer + j * n_z + 1 + odd)
            for n in range(np.uint64((n_z - 1 - odd) // 2)):
                value = x[first + n + n] + scale * correction[place + n]
                x[first + n + n] = value
                total += value * value
        sums[i] = total
