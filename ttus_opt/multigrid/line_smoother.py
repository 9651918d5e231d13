"""Compiled smoother of the multigrid solver: radial lines, solved exactly.

A sweep solves every radial line of one colour, all at once: lines of one colour do
not touch, and Thomas' algorithm runs over many of them side by side in the vector
registers. Fixed nodes have a zero inverse pivot: they stay zero and part the lines
without a branch. Arrays and arguments are those of `kernels`.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.compiled import compiled
from ttus_opt.multigrid.kernels import FAST, Numbers, Single, close_circle, span

#: Lines solved side by side; a block of them stays in the second-level cache.
TILE = 1024


@compiled(nogil=True)
def pivots(aside: Single, R: Single) -> Single:
    """Inverse pivots of Thomas' algorithm for every line (compiled).

    What a line so far holds its last node with is the node's own conductance aside
    and, through their link, that of the line before: no differences are taken, so
    that links of any stiffness leave the others their digits.

    Args:
        aside: Diagonal of the operator without links along lines, in halves; zero at
            fixed nodes and nowhere else.
        R: Conductances to the next layer.

    Returns:
        The same shape; zero at fixed nodes.
    """
    inverse = np.zeros_like(aside)
    for c in range(2):
        held = np.zeros(inverse.shape[2])
        for i in range(1, inverse.shape[1] - 1):
            for h in range(inverse.shape[2]):
                own = np.float64(aside[c, i, h])
                if own > 0.0 and held[h] > 0.0:
                    r = np.float64(R[i - 1] if R.ndim == 1 else R[c, i - 1, h])
                    own += r * held[h] / (r + held[h])
                held[h] = own
                if own > 0.0:
                    if aside[c, i + 1, h] > 0.0:
                        own += np.float64(R[i] if R.ndim == 1 else R[c, i, h])
                    inverse[c, i, h] = 1.0 / own
    return inverse


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_even(
    out: Single,
    below: Single,
    b: Single,
    zl: Single,
    zr: Single,
    tl: Single,
    tr: Single,
    r: np.float32,
    z: np.float32,
    t: np.float32,
    inverse: Single,
) -> None:
    """Forward step of one layer, conductances r, z, t of the layer (compiled)."""
    for n in range(out.size):
        load = b[n] + z * (zl[n] + zr[n]) + t * (tl[n] + tr[n])
        out[n] = (load + r * below[n]) * inverse[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_even_unloaded(
    out: Single,
    below: Single,
    zl: Single,
    zr: Single,
    tl: Single,
    tr: Single,
    r: np.float32,
    z: np.float32,
    t: np.float32,
    inverse: Single,
) -> None:
    """The same without a right-hand side (compiled)."""
    for n in range(out.size):
        load = z * (zl[n] + zr[n]) + t * (tl[n] + tr[n])
        out[n] = (load + r * below[n]) * inverse[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_tied(
    out: Single,
    below: Single,
    b: Single,
    zl: Single,
    zr: Single,
    tl: Single,
    tr: Single,
    r: Single,
    z: np.float32,
    t: np.float32,
    inverse: Single,
) -> None:
    """Forward step of one layer, a conductance for every link inwards (compiled)."""
    for n in range(out.size):
        load = b[n] + z * (zl[n] + zr[n]) + t * (tl[n] + tr[n])
        out[n] = (load + r[n] * below[n]) * inverse[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_tied_unloaded(
    out: Single,
    below: Single,
    zl: Single,
    zr: Single,
    tl: Single,
    tr: Single,
    r: Single,
    z: np.float32,
    t: np.float32,
    inverse: Single,
) -> None:
    """The same without a right-hand side (compiled)."""
    for n in range(out.size):
        load = z * (zl[n] + zr[n]) + t * (tl[n] + tr[n])
        out[n] = (load + r[n] * below[n]) * inverse[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_uneven(
    out: Single,
    below: Single,
    b: Single,
    zl: Single,
    zr: Single,
    tl: Single,
    tr: Single,
    r: Single,
    cl: Single,
    cr: Single,
    dl: Single,
    dr: Single,
    inverse: Single,
) -> None:
    """Forward step of one layer, a conductance for every link (compiled)."""
    for n in range(out.size):
        load = b[n] + cl[n] * zl[n] + cr[n] * zr[n] + dl[n] * tl[n] + dr[n] * tr[n]
        out[n] = (load + r[n] * below[n]) * inverse[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_alone(
    out: Single, below: Single, b: Single, r: np.float32, inverse: Single
) -> None:
    """Forward step of one layer while the other colour is zero (compiled)."""
    for n in range(out.size):
        out[n] = (b[n] + r * below[n]) * inverse[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_alone_uneven(
    out: Single, below: Single, b: Single, r: Single, inverse: Single
) -> None:
    """The same with a conductance for every link (compiled)."""
    for n in range(out.size):
        out[n] = (b[n] + r[n] * below[n]) * inverse[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_back(out: Single, above: Single, r: np.float32, inverse: Single) -> None:
    """Backward step of one layer (compiled)."""
    for n in range(out.size):
        out[n] += r * inverse[n] * above[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_back_uneven(out: Single, above: Single, r: Single, inverse: Single) -> None:
    """The same with a conductance for every link (compiled)."""
    for n in range(out.size):
        out[n] += r[n] * inverse[n] * above[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _back(out: Single, inverse: Single, R: Single, colour: int, s: int, e: int) -> None:
    """Backward substitution of the lines of places s to e (compiled)."""
    for i in range(out.shape[0] - 3, 0, -1):
        if R.ndim == 1:
            _row_back(out[i, s:e], out[i + 1, s:e], R[i], inverse[i, s:e])
        else:
            _row_back_uneven(
                out[i, s:e], out[i + 1, s:e], R[colour, i, s:e], inverse[i, s:e]
            )


@compiled(nogil=True, fastmath=FAST)
def sweep_alone(
    x: Single, b: Single, inverse: Single, R: Single, colour: int, numbers: Numbers
) -> None:
    """As `sweep` while the other colour is zero (compiled)."""
    out = x[colour]
    first, last = span(colour, numbers)
    for s in range(first, last, TILE):
        e = min(s + TILE, last)
        for i in range(1, out.shape[0] - 1):
            own, below, load = out[i, s:e], out[i - 1, s:e], b[i, s:e]
            if R.ndim == 1:
                _row_alone(own, below, load, R[i - 1], inverse[i, s:e])
            else:
                r = R[colour, i - 1, s:e]
                _row_alone_uneven(own, below, load, r, inverse[i, s:e])
        _back(out, inverse, R, colour, s, e)
    close_circle(x, colour, numbers)


@compiled(nogil=True, fastmath=FAST)
def sweep_unloaded(
    x: Single,
    opposite: Single,
    inverse: Single,
    R: Single,
    T: Single,
    Z: Single,
    colour: int,
    numbers: Numbers,
) -> None:
    """As `sweep` without a right-hand side, finest level only (compiled)."""
    out = x[colour]
    first, last = span(colour, numbers)
    c, q = colour, numbers[2] // 2
    for s in range(first, last, TILE):
        e = min(s + TILE, last)
        for i in range(1, out.shape[0] - 1):
            own, below, d = out[i, s:e], out[i - 1, s:e], inverse[i, s:e]
            y = opposite[i]
            zl, zr = y[s - 1 + c : e - 1 + c], y[s + c : e + c]
            tl, tr = y[s - q - 1 + c : e - q - 1 + c], y[s + q + c : e + q + c]
            if R.ndim == 1:
                _row_even_unloaded(own, below, zl, zr, tl, tr, R[i - 1], Z[i], T[i], d)
            else:
                r = R[c, i - 1, s:e]
                _row_tied_unloaded(own, below, zl, zr, tl, tr, r, Z[i], T[i], d)
        _back(out, inverse, R, c, s, e)
    close_circle(x, c, numbers)


@compiled(nogil=True, fastmath=FAST)
def sweep(
    x: Single,
    opposite: Single,
    b: Single,
    inverse: Single,
    R: Single,
    T: Single,
    Z: Single,
    colour: int,
    numbers: Numbers,
) -> None:
    """Solve every radial line of one colour, given the other colour (compiled).

    Args:
        x: Both halves; that of this colour is the result, shape (2, n_r, width).
        opposite: Values of the other colour, shape (n_r, width).
        b: Right-hand side of this colour.
        inverse: Inverse pivots of this colour.
        R: Conductances to the next layer.
        T: Conductances to the next spoke.
        Z: Conductances to the next slice.
        colour: 0 or 1.
        numbers: See the module.
    """
    out = x[colour]
    first, last = span(colour, numbers)
    c, q = colour, numbers[2] // 2
    for s in range(first, last, TILE):
        e = min(s + TILE, last)
        for i in range(1, out.shape[0] - 1):
            own, below, d = out[i, s:e], out[i - 1, s:e], inverse[i, s:e]
            y, load = opposite[i], b[i, s:e]
            zl, zr = y[s - 1 + c : e - 1 + c], y[s + c : e + c]
            tl, tr = y[s - q - 1 + c : e - q - 1 + c], y[s + q + c : e + q + c]
            if R.ndim == 1:
                _row_even(own, below, load, zl, zr, tl, tr, R[i - 1], Z[i], T[i], d)
            elif T.ndim == 1:
                r = R[c, i - 1, s:e]
                _row_tied(own, below, load, zl, zr, tl, tr, r, Z[i], T[i], d)
            else:
                cl, cr = Z[1 - c, i, s - 1 + c : e - 1 + c], Z[c, i, s:e]
                dl = T[1 - c, i, s - q - 1 + c : e - q - 1 + c]
                dr, r = T[c, i, s:e], R[c, i - 1, s:e]
                _row_uneven(own, below, load, zl, zr, tl, tr, r, cl, cr, dl, dr, d)
        _back(out, inverse, R, c, s, e)
    close_circle(x, c, numbers)
