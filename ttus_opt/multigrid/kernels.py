"""Compiled kernels of the multigrid solver: operators and vectors in halves.

Arrays in halves have shape (n_r, width) per colour as `levels.Layout`
stores them. Conductances R, T, Z are one number per layer on the finest level,
arrays in halves on the others; the compiler keeps one of the two ways. Inverse
pivots are those of `lines`, zero at fixed nodes. ``numbers`` is (n_theta,
n_z, pitch). Kernels hold no lock and release the interpreter's: several solves may
run side by side, each on one core, which wastes less than sharing one among cores.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.compiled import compiled

Single = NDArray[np.float32]
Numbers = tuple[int, int, int]

FAST = {"contract", "reassoc"}  # sums may be reordered; NaN and inf keep their sense


@compiled(inner=True, nogil=True, fastmath=FAST)
def span(colour: int, numbers: Numbers) -> tuple[int, int]:
    """First place of the real rows of one colour, and the place after the last."""
    n_theta, _, pitch = numbers
    return (pitch - colour + 1) // 2, ((n_theta + 1) * pitch - colour + 1) // 2


@compiled(nogil=True)
def close_circle(x: Single, colour: int, numbers: Numbers) -> None:
    """Copy the outer rows of one colour to where θ closes (compiled).

    With an odd number of rows the copy of a row has the other colour.

    Args:
        x: Both halves, shape (2, n_r, width).
        colour: Colour whose values have changed.
        numbers: See the module.
    """
    n_theta, _, pitch = numbers
    turn = n_theta * pitch
    target = (colour + turn) % 2
    low, high = span(target, numbers)
    end = ((n_theta + 2) * pitch - target + 1) // 2
    up = (target + turn - colour) // 2
    down = (turn + colour - target) // 2
    for i in range(1, x.shape[1] - 1):
        source, out = x[colour, i], x[target, i]
        for h in range(low):
            out[h] = source[h + up]
        for h in range(high, end):
            out[h] = source[h - down]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_couple(
    out: Single,
    zl: Single,
    zr: Single,
    tl: Single,
    tr: Single,
    z: np.float32,
    t: np.float32,
    inverse: Single,
    less: np.float32,
) -> None:
    """What flows into one layer (compiled)."""
    for n in range(out.size):
        load = z * (zl[n] + zr[n]) + t * (tl[n] + tr[n]) - less * out[n]
        out[n] = load if inverse[n] != 0 else np.float32(0)


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_couple_uneven(
    out: Single,
    zl: Single,
    zr: Single,
    tl: Single,
    tr: Single,
    cl: Single,
    cr: Single,
    dl: Single,
    dr: Single,
    less: np.float32,
) -> None:
    """The same with a conductance for every link (compiled)."""
    for n in range(out.size):
        load = cl[n] * zl[n] + cr[n] * zr[n] + dl[n] * tl[n] + dr[n] * tr[n]
        out[n] = load - less * out[n]


@compiled(nogil=True, fastmath=FAST)
def couple(
    out: Single,
    opposite: Single,
    less: np.float32,
    inverse: Single,
    T: Single,
    Z: Single,
    numbers: Numbers,
) -> None:
    """What flows into colour 1 from colour 0 (compiled).

    Args:
        out: Result, shape (n_r, width).
        opposite: Values of colour 0, shape (n_r, width).
        less: How often to take off what ``out`` held, 0 or 1.
        inverse: Inverse pivots of colour 1, shape (n_r, width).
        T: Conductances to the next spoke.
        Z: Conductances to the next slice.
        numbers: See the module.
    """
    s, e = span(1, numbers)
    q = numbers[2] // 2
    for i in range(1, out.shape[0] - 1):
        x, own = opposite[i], out[i, s:e]
        zl, zr = x[s:e], x[s + 1 : e + 1]
        tl, tr = x[s - q : e - q], x[s + q + 1 : e + q + 1]
        if T.ndim == 1:
            _row_couple(own, zl, zr, tl, tr, Z[i], T[i], inverse[i, s:e], less)
        else:
            cl, cr = Z[0, i, s:e], Z[1, i, s:e]
            dl, dr = T[0, i, s - q : e - q], T[1, i, s:e]
            _row_couple_uneven(own, zl, zr, tl, tr, cl, cr, dl, dr, less)


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_operator(
    out: Single,
    own: Single,
    below: Single,
    above: Single,
    zl: Single,
    zr: Single,
    tl: Single,
    tr: Single,
    rl: np.float32,
    rr: np.float32,
    z: np.float32,
    t: np.float32,
    inverse: Single,
) -> np.float32:
    total = np.float32(0)
    d = rl + rr + np.float32(2) * (z + t)
    for n in range(out.size):
        value = d * own[n] - rl * below[n] - rr * above[n]
        value -= z * (zl[n] + zr[n]) + t * (tl[n] + tr[n])
        value = value if inverse[n] != 0 else np.float32(0)
        out[n] = value
        total += value * own[n]
    return total


@compiled(inner=True, nogil=True, fastmath=FAST)
def operate(
    out: Single,
    own: Single,
    opposite: Single,
    inverse: Single,
    R: Single,
    T: Single,
    Z: Single,
    colour: int,
    numbers: Numbers,
) -> float:
    """Rows of one colour of A x on the finest level, and their share of x·Ax.

    Args:
        out: Result, shape (n_r, width).
        own: x of this colour.
        opposite: x of the other colour; other arguments as `couple`.
        inverse: See `couple`.
        R: See `couple`.
        T: See `couple`.
        Z: See `couple`.
        colour: 0 or 1.
        numbers: See the module.

    Returns:
        The sum of own · out.
    """
    s, e = span(colour, numbers)
    q, c = numbers[2] // 2, colour
    total = 0.0
    for i in range(1, out.shape[0] - 1):
        x = opposite[i]
        zl, zr = x[s - 1 + c : e - 1 + c], x[s + c : e + c]
        tl, tr = x[s - q - 1 + c : e - q - 1 + c], x[s + q + c : e + q + c]
        total += _row_operator(
            out[i, s:e],
            own[i, s:e],
            own[i - 1, s:e],
            own[i + 1, s:e],
            zl,
            zr,
            tl,
            tr,
            R[i - 1],
            R[i],
            Z[i],
            T[i],
            inverse[i, s:e],
        )
    return total


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_dot(a: Single, b: Single) -> np.float32:
    total = np.float32(0)
    for n in range(a.size):
        total += a[n] * b[n]
    return total


@compiled(inner=True, nogil=True, fastmath=FAST)
def dot(a: Single, b: Single, colour: int, numbers: Numbers) -> float:
    """Sum of a · b over the real rows of one colour (compiled)."""
    s, e = span(colour, numbers)
    total = 0.0
    for i in range(1, a.shape[0] - 1):
        total += _row_dot(a[i, s:e], b[i, s:e])
    return total


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_step(
    x: Single, r: Single, p: Single, q: Single, alpha: np.float32
) -> np.float32:
    total = np.float32(0)
    for n in range(x.size):
        x[n] += alpha * p[n]
        r[n] -= alpha * q[n]
        total += r[n] * r[n]
    return total


@compiled(inner=True, nogil=True, fastmath=FAST)
def step(
    x: Single,
    r: Single,
    p: Single,
    q: Single,
    alpha: np.float32,
    colour: int,
    numbers: Numbers,
) -> float:
    """One step: x += α p, r -= α q in the real rows; returns r · r (compiled)."""
    s, e = span(colour, numbers)
    total = 0.0
    for i in range(1, x.shape[0] - 1):
        total += _row_step(x[i, s:e], r[i, s:e], p[i, s:e], q[i, s:e], alpha)
    return total


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_turn(p: Single, z: Single, beta: np.float32) -> None:
    for n in range(p.size):
        p[n] = z[n] + beta * p[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def turn(p: Single, z: Single, beta: np.float32) -> None:
    """Next direction: p = z + β p, closing rows included (compiled)."""
    for i in range(1, p.shape[0] - 1):
        _row_turn(p[i], z[i], beta)


@compiled(inner=True, nogil=True)
def copy(out: Single, a: Single) -> None:
    """Copy one colour (compiled).

    A slice set to another takes seconds to compile: for the message that would say
    their shapes differ.
    """
    for i in range(out.shape[0]):
        for n in range(out.shape[1]):
            out[i, n] = a[i, n]


@compiled(nogil=True, fastmath=FAST)
def direct(
    x: Single, b0: Single | None, b1: Single, places: NDArray[np.int64], inverse: Single
) -> None:
    """Solve the coarsest level (compiled).

    Args:
        x: Result in halves, shape (2, n_r, width).
        b0: Right-hand side of colour 0, None for zero, shape (n_r, width).
        b1: Right-hand side of colour 1, same shape.
        places: Flat places of the unknowns in halves, shape (n,).
        inverse: Inverse of the matrix, shape (n, n).
    """
    half, width = x.shape[1] * x.shape[2], x.shape[2]
    load = np.zeros(places.size, dtype=np.float32)
    for n in range(places.size):
        i, h = (places[n] % half) // width, places[n] % width
        if places[n] >= half:
            load[n] = b1[i, h]
        elif b0 is not None:
            load[n] = b0[i, h]
    for n in range(places.size):
        i, h = (places[n] % half) // width, places[n] % width
        x[places[n] // half, i, h] = _row_dot(inverse[n], load)
