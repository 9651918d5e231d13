"""The operator A in double precision, on whole grids of voxels in C order.

The outer part of the multigrid solver: residuals, and corrections from the single
precision halves of `levels.Layout`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array
from ttus_opt.compiled import compiled
from ttus_opt.multigrid.kernels import FAST, Numbers, Single


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_operator(
    out: Array,
    own: Array,
    below: Array,
    above: Array,
    before: Array,
    after: Array,
    rl: float,
    rr: float,
    t: float,
    z: float,
) -> None:
    """A x for rows in a row, apart from the ends; own has one more each side."""
    d = rl + rr + 2.0 * t + 2.0 * z
    for n in range(out.size):
        value = d * own[n + 1] - rl * below[n] - rr * above[n]
        out[n] = value - t * (before[n] + after[n]) - z * (own[n] + own[n + 2])


@compiled(inner=True, nogil=True, fastmath=FAST)
def _layer(
    out: Array, x: Array, i: int, r: Array, t: Array, z: Array, shape: Numbers
) -> None:
    """A x in layer i, with nonsense in the first and last slice (compiled)."""
    _, n_theta, n_z = shape
    ring = n_theta * n_z
    start = i * ring
    for low, high in ((0, n_z), (n_z, ring - n_z), (ring - n_z, ring)):
        a, b = start + low, start + high  # the rows next to the seam on their own
        before = a - n_z if low > 0 else start + ring - n_z
        after = a + n_z if high < ring else start
        _row_operator(
            out[low:high],
            x[a - 1 : b + 1],
            x[a - ring : b - ring],
            x[a + ring : b + ring],
            x[before : before + high - low],
            x[after : after + high - low],
            r[i - 1],
            r[i],
            t[i],
            z[i],
        )


@compiled(nogil=True, fastmath=FAST)
def operate(
    out: Array,
    x: Array,
    free: NDArray[np.bool_],
    r: Array,
    t: Array,
    z: Array,
    shape: Numbers,
) -> None:
    """A x (compiled).

    Args:
        out: Result, shape (V,); zero at fixed voxels.
        x: Values, zero at fixed voxels, shape (V,).
        free: Unknown voxels, shape (V,).
        r: Conductances to the next layer, shape (n_r,).
        t: Conductances to the next spoke, shape (n_r,).
        z: Conductances to the next slice, shape (n_r,).
        shape: Of the grid.
    """
    n_r, n_theta, n_z = shape
    ring = n_theta * n_z
    for i in range(1, n_r - 1):
        _layer(out[i * ring : (i + 1) * ring], x, i, r, t, z, shape)
    for n in range(out.size):
        out[n] = out[n] if free[n] else 0.0


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_residual(line: Array, b: Array, free: NDArray[np.bool_]) -> float:
    """Turn a row of A x into that of b - A x; returns its square (compiled)."""
    total = 0.0
    for k in range(line.size):
        value = b[k] - line[k] if free[k] else 0.0
        line[k] = value
        total += value * value
    return total


@compiled(inner=True, nogil=True, fastmath=FAST)
def _pick(out: Single, a: Array, scale: float) -> None:
    for n in range(out.size):
        out[n] = scale * a[n]


@compiled(nogil=True, fastmath=FAST)
def residual(
    out: Single,
    x: Array | None,
    b: Array,
    free: NDArray[np.bool_],
    r: Array,
    t: Array,
    z: Array,
    scale: float,
    pitch: int,
    shape: Numbers,
) -> float:
    """Residual b - A x, scaled, into halves (compiled).

    Args:
        out: Result in halves, single precision, shape (2, n_r, width).
        x: Values, zero at fixed voxels, shape (V,), or None for zero.
        b: Right-hand side, shape (V,).
        free: See `operate`.
        r: See `operate`.
        t: See `operate`.
        z: See `operate`.
        scale: Factor of ``out`` [–].
        pitch: Of the finest level [–].
        shape: Of the grid.

    Returns:
        Sum of the squared residuals, unscaled.
    """
    n_r, n_theta, n_z = shape
    ring = n_theta * n_z
    total = 0.0
    layer = np.zeros(ring)
    for i in range(1, n_r - 1):
        own, end = i * ring, (i + 1) * ring
        if x is not None:
            _layer(layer, x, i, r, t, z, shape)
        else:
            layer[:] = 0.0
        total += _row_residual(layer, b[own:end], free[own:end])
        for j in range(n_theta):
            row = layer[j * n_z : (j + 1) * n_z]
            for odd in range(2):
                m = (j + 1) * pitch + 1 + odd
                place = out[m & 1, i, m >> 1 : (m >> 1) + (n_z - 1 - odd) // 2]
                _pick(place, row[1 + odd :: 2], scale)
    return total


@compiled(nogil=True, fastmath=FAST)
def add(x: Array, halves: Single, scale: float, pitch: int, shape: Numbers) -> float:
    """Correct x by scale · halves; returns the sum of the new x² (compiled).

    Args:
        x: Values, shape (V,).
        halves: Correction in halves, zero at fixed voxels, shape (2, n_r, width).
        scale: Factor [–].
        pitch: Of the finest level [–].
        shape: Of the grid.
    """
    n_r, n_theta, n_z = shape
    total = 0.0
    for i in range(1, n_r - 1):
        for j in range(n_theta):
            own = (i * n_theta + j) * n_z
            start = (j + 1) * pitch
            for odd in range(2):
                m = start + 1 + odd
                place = halves[m & 1, i, m >> 1 : (m >> 1) + (n_z - 1 - odd) // 2]
                row = x[own + 1 + odd : own + n_z : 2]
                for n in range(place.size):
                    value = row[n] + scale * place[n]
                    row[n] = value
                    total += value * value
    return total
