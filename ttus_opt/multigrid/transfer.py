"""Compiled transfers between two levels of the multigrid solver.

Residuals live on colour 1 alone: a sweep ends with colour 0, whose equations then
hold, and what is added to colour 0 would be overwritten by the sweep that follows.
Colour 1 has the spokes and slices that are both even (nodes of a coarse level) or
both odd (in the middle of four of them). Interpolation goes one direction after the
other, θ, z, then r, by the weights of each line, so that a value never passes
through a fixed node; restriction is exactly its transpose.

In a layer of colour 1, even row j starts at place (j + 1)·pitch // 2 with slice 0,
odd row j with slice 1. Rows j and j + 2 lie a whole pitch apart, so that one loop
runs over all rows of a layer; where a formula is meant for odd rows only, it leaves
nonsense in even ones, which nobody reads.

``flags`` says which of r, θ, z were coarsened; ``fine`` and ``coarse`` are the
(n_theta, n_z, pitch) of the levels; ``weights`` are six arrays in halves: of the
node before and after in r, θ, z.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.compiled import compiled
from ttus_opt.multigrid.kernels import FAST, Numbers, Single, span

Weights = tuple[Single, ...]
Flags = tuple[bool, bool, bool]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _copy(out: Single, a: Single) -> None:
    for n in range(out.size):
        out[n] = a[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _add(out: Single, a: Single) -> None:
    for n in range(out.size):
        out[n] += a[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _add_product(out: Single, w: Single, a: Single) -> None:
    for n in range(w.size):
        out[n] += w[n] * a[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _mix(out: Single, wa: Single, a: Single, wb: Single, b: Single) -> None:
    """Set wa · a + wb · b (compiled)."""
    for n in range(wb.size):
        out[n] = wa[n] * a[n] + wb[n] * b[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _add_mix(out: Single, wa: Single, a: Single, wb: Single, b: Single) -> None:
    """Add wa · a + wb · b (compiled)."""
    for n in range(wb.size):
        out[n] += wa[n] * a[n] + wb[n] * b[n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _exchange(
    rows: Single,
    plane: Single,
    row: int,
    j: int,
    into: bool,
    flags: Flags,
    fine: Numbers,
    coarse: Numbers,
) -> None:
    """Copy between a fine row of colour 1 and the coarse slices it meets (compiled).

    A coarse plane is one row after the other if z was coarsened, else one half after
    the other. On the way ``into`` it, sums for coarse slice n of an odd row stand at
    the place of fine slice 2n - 1; on the way out, slice n goes to that of 2n + 1.
    """
    pitch = coarse[2]
    start = (j + 1) * fine[2] // 2
    odd = j % 2
    if flags[2]:
        a = (row + 1) * pitch
        count = fine[1] // 2
        if into:
            a, count = a + 1, count - 1  # the first slice and the last are fixed
            start += 1 - odd
        else:
            count += odd
    else:
        m = (row + 1) * pitch + odd
        a = (m % 2) * (plane.size // 2) + m // 2
        count = (fine[1] - odd) // 2
    if into:
        _copy(plane[a : a + count], rows[start : start + count])
    else:
        _copy(rows[start : start + count], plane[a : a + count])


@compiled(inner=True, nogil=True, fastmath=FAST)
def _restrict_rows(
    plane: Single,
    values: Single,
    between: Single,
    total: Single,
    i: int,
    weights: Weights,
    flags: Flags,
    fine: Numbers,
    coarse: Numbers,
) -> None:
    """Residuals of one layer onto the coarse rows and slices (compiled)."""
    rows, _, pitch = fine
    size = weights[0].shape[2]
    q = pitch // 2
    if rows % 2 == 0:  # row -1 is the last one; of an odd number of rows, none is
        last = rows * pitch // 2
        _copy(values[:q], values[last : last + q])
    odd = values
    if flags[2]:
        after, before = weights[5][1, i], weights[4][1, i]
        n = size - 1
        _mix(between, after[:n], values, before[1:], values[1:])
        odd = between
    if not flags[1]:
        for j in range(rows):
            source = odd if j % 2 else values
            _exchange(source, plane, j, j, True, flags, fine, coarse)
        return
    colour = 0 if flags[2] else 1
    before, after = weights[2][colour, i], weights[3][colour, i]
    if flags[2]:
        _copy(total, values)
        n = size - 2 * q - 1
        below, above = after[1 : 1 + n], before[2 * q + 2 :]
        _add_mix(total[q + 1 :], below, odd, above, odd[2 * q + 1 :])
        for row in range(coarse[0]):
            _exchange(total, plane, row, 2 * row, True, flags, fine, coarse)
        return
    n = size - pitch
    _mix(total[pitch:], after[:n], odd, before[pitch:], odd[pitch:])
    for row in range(coarse[0]):
        _exchange(values, plane, row, 2 * row, True, flags, fine, coarse)
        _exchange(total, plane, row, 2 * row + 1, True, flags, fine, coarse)


@compiled(nogil=True, fastmath=FAST)
def restrict(
    out: Single,
    residual: Single,
    weights: Weights,
    flags: Flags,
    fine: Numbers,
    coarse: Numbers,
) -> None:
    """Right-hand side of the coarse level (compiled).

    Args:
        out: Result in halves, shape (2, n_r, width) of the coarse level.
        residual: Residuals of colour 1, shape (n_r, width) of the fine level, zero
            where rows close the circle.
        weights: See the module.
        flags: See the module.
        fine: See the module.
        coarse: See the module.
    """
    size, width = residual.shape[1], out.shape[2]
    values = np.zeros(size + 2 * fine[2], dtype=np.float32)
    between, total = np.zeros_like(values), np.zeros_like(values)
    plane = np.zeros(2 * width, dtype=np.float32)
    before, after = weights[0][1], weights[1][1]
    for layer in range(1, out.shape[1] - 1):
        i = 2 * layer if flags[0] else layer
        _copy(values[:size], residual[i])
        if flags[0]:
            low, high = residual[i - 1], residual[i + 1]
            _add_mix(values, after[i - 1], low, before[i + 1], high)
        _restrict_rows(plane, values, between, total, i, weights, flags, fine, coarse)
        one, other = out[0, layer], out[1, layer]
        if flags[2]:
            for n in range(width):
                one[n] = plane[2 * n]
                other[n] = plane[2 * n + 1]
        else:
            _copy(one, plane[:width])
            _copy(other, plane[width:])


@compiled(inner=True, nogil=True, fastmath=FAST)
def _prolong_rows(
    out: Single,
    plane: Single,
    known: Single,
    between: Single,
    is_odd: Single,
    i: int,
    weights: Weights,
    flags: Flags,
    fine: Numbers,
    coarse: Numbers,
) -> None:
    """Add to out one coarse layer at the rows and slices of a fine one (compiled)."""
    rows, _, pitch = fine
    size = weights[0].shape[2]
    q = pitch // 2
    if flags[1]:
        for row in range(coarse[0] + 1 - rows % 2):
            _exchange(known, plane, row, 2 * row, False, flags, fine, coarse)
            if not flags[2]:
                _exchange(known, plane, row, 2 * row + 1, False, flags, fine, coarse)
    else:
        for j in range(rows):
            _exchange(known, plane, j, j, False, flags, fine, coarse)
    odd = known
    if flags[1]:
        colour = 0 if flags[2] else 1
        before, after = weights[2][colour, i], weights[3][colour, i]
        if flags[2]:
            low, high = before[q + 1 :], after[q + 1 :]
            _mix(between[q + 1 :], low, known, high, known[2 * q + 1 :])
        else:
            _mix(between, before, known, after, known[pitch:])
        odd = between
    if flags[2]:
        before, after = weights[4][1, i], weights[5][1, i]
        _mix(out, before, odd, after, odd[1:])
        odd = out
    for n in range(size):
        out[n] = known[n] + is_odd[n] * (odd[n] - known[n])


@compiled(nogil=True, fastmath=FAST)
def prolong(
    out: Single,
    x: Single,
    weights: Weights,
    flags: Flags,
    fine: Numbers,
    coarse: Numbers,
) -> None:
    """Add the coarse correction to colour 1 (compiled).

    Args:
        out: Values of colour 1, shape (n_r, width) of the fine level; its closing
            rows, which may hold the other colour, are left alone.
        x: Correction in halves, shape (2, n_r, width) of the coarse level, closed.
        weights: See the module.
        flags: See the module.
        fine: See the module.
        coarse: See the module.
    """
    n_r, size = out.shape
    width, pitch = x.shape[2], fine[2]
    s, e = span(1, fine)
    before, after = weights[0][1], weights[1][1]
    below = np.zeros(size, dtype=np.float32)
    here = np.zeros(size, dtype=np.float32)
    known = np.zeros(size + 2 * pitch, dtype=np.float32)
    between = np.zeros_like(known)
    plane = np.empty(2 * width, dtype=np.float32)
    is_odd = np.zeros(size, dtype=np.float32)
    for j in range(-1, fine[0] + 1, 2):
        start = (j + 1) * pitch // 2
        is_odd[start : start + pitch // 2] = 1
    for layer in range(1, x.shape[1] - 1):
        i = 2 * layer if flags[0] else layer
        one, other = x[0, layer], x[1, layer]
        if flags[2]:
            for n in range(width):
                plane[2 * n] = one[n]
                plane[2 * n + 1] = other[n]
        else:
            _copy(plane[:width], one)
            _copy(plane[width:], other)
        _prolong_rows(
            here,
            plane,
            known,
            between,
            is_odd,
            i,
            weights,
            flags,
            fine,
            coarse,
        )
        _add(out[i, s:e], here[s:e])
        if flags[0]:
            low, high = before[i - 1, s:e], after[i - 1, s:e]
            _add_mix(out[i - 1, s:e], low, below[s:e], high, here[s:e])
            below, here = here, below
    last = 2 * x.shape[1] - 3
    if flags[0] and last < n_r - 1:
        _add_product(out[last, s:e], before[last, s:e], below[s:e])
