"""Restriction and prolongation between two levels (compiled).

Operator-dependent interpolation as in black-box multigrid (Dendy, J. Comput. Phys. 48,
1982), here along one line after the other, θ, z, then r, so that no value passes
through a Dirichlet node. Restriction is exactly the transpose.

Residuals live on black nodes alone: a sweep ends with the red ones, whose equations
then hold, and a correction of red nodes would be overwritten by the next sweep. A node
is black if its spoke and slice are both even (a node of the coarse level) or both odd
(in the middle of four such nodes). In a layer, even spoke j starts at place
(j + 1)·pitch // 2 with slice 0, odd spoke j with slice 1. Spokes j and j + 2 lie a
whole pitch apart, so that one loop runs over all spokes of a layer; a formula for odd
spokes leaves values in the even ones that are never read.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ttus_opt.core.compiled import compiled
from ttus_opt.laplace.multigrid.kernels import (
    FAST,
    LevelIndex,
    Part,
    bounds,
    copy,
    fill,
    span,
)
from ttus_opt.laplace.multigrid.red_black import Single


class Mean(NamedTuple):
    """Places of a weighted mean of two vectors, added to a third.

    Attributes:
        out: The result.
        base: What the mean is added to.
        weight: Weights of the first vector, in ``fields``.
        first: The first vector.
        other_weight: Weights of the second vector.
        second: The second vector.
    """

    out: int
    base: int
    weight: int
    first: int
    other_weight: int
    second: int


class Buffers(NamedTuple):
    """Scratch space of a transfer, in ``work``.

    Attributes:
        values: Values of one fine layer.
        between: Their means along one direction.
        total: Their sums.
        plane: One coarse layer, both colours.
        here: A fine layer on the way from the coarse one.
        below: The one before it.
        is_odd: 1 on odd spokes, else 0.
    """

    values: int
    between: int
    total: int
    plane: int
    here: int
    below: int
    is_odd: int


def scratch_size(width: int, pitch: int) -> int:
    """Numbers that the scratch space of the finest level takes."""
    return 3 * (width + 2 * pitch) + 5 * width


@compiled(inline="always")
def _buffers(at: LevelIndex, work: Single) -> Buffers:
    """Empty scratch space of a level (compiled)."""
    width, long = at.width, at.width + 2 * at.pitch
    fill(work, at.scratch, np.float32(0), 3 * long + 5 * width)
    plane = at.scratch + 3 * long
    return Buffers(
        at.scratch,
        at.scratch + long,
        at.scratch + 2 * long,
        plane,
        plane + 2 * width,
        plane + 3 * width,
        plane + 4 * width,
    )


@compiled(inner=True, nogil=True, fastmath=FAST)
def _add_mean(work: Single, fields: Single, at: Mean, count: int) -> None:
    """Set base + weight · first + other weight · second (compiled)."""
    out, base = np.uint64(at.out), np.uint64(at.base)
    weight, first = np.uint64(at.weight), np.uint64(at.first)
    other, second = np.uint64(at.other_weight), np.uint64(at.second)
    for n in range(np.uint64(count)):
        mean = fields[weight + n] * work[first + n]
        mean += fields[other + n] * work[second + n]
        work[out + n] = work[base + n] + mean


@compiled(inner=True, nogil=True, fastmath=FAST)
def _add(work: Single, out: int, source: int, count: int) -> None:
    """Add one vector to another (compiled)."""
    to, start = np.uint64(out), np.uint64(source)
    for n in range(np.uint64(count)):
        work[to + n] += work[start + n]


@compiled(inner=True, nogil=True)
def _split(work: Single, plane: int, red: int, black: int, count: int) -> None:
    """Part a plane in which colours alternate into its colours (compiled)."""
    start, one, other = np.uint64(plane), np.uint64(red), np.uint64(black)
    for n in range(np.uint64(count)):
        work[one + n] = work[start + n + n]
        work[other + n] = work[start + n + n + np.uint64(1)]


@compiled(inner=True, nogil=True)
def _merge(work: Single, plane: int, red: int, black: int, count: int) -> None:
    """The reverse of `_split` (compiled)."""
    start, one, other = np.uint64(plane), np.uint64(red), np.uint64(black)
    for n in range(np.uint64(count)):
        work[start + n + n] = work[one + n]
        work[start + n + n + np.uint64(1)] = work[other + n]


@compiled(inner=True, nogil=True)
def _swap(
    at: LevelIndex,
    below: LevelIndex,
    work: Single,
    places: tuple[int, int],
    spokes: tuple[int, int],
    into: np.bool_,
) -> None:
    """Copy between a fine spoke of black nodes and its coarse slices (compiled).

    A coarse plane is one spoke after the other if z was coarsened, else one colour
    after the other. On the way ``into`` it, sums for coarse slice n of an odd spoke
    stand at the place of fine slice 2n - 1; on the way out, slice n goes to that of
    2n + 1.
    """
    (values, plane), (coarse_spoke, j) = places, spokes
    start, odd = (j + 1) * at.pitch // 2, j % 2
    if at.coarsens_z:
        a = (coarse_spoke + 1) * below.pitch
        count = at.n_z // 2
        if into:
            a, count = a + 1, count - 1  # the first slice and the last are Dirichlet
            start += 1 - odd
        else:
            count += odd
    else:
        m = (coarse_spoke + 1) * below.pitch + odd
        a = (m % 2) * below.width + m // 2
        count = (at.n_z - odd) // 2
    if into:
        copy(work, plane + a, values + start, count)
    else:
        copy(work, values + start, plane + a, count)


@compiled(inner=True, nogil=True)
def _swap_plane(
    at: LevelIndex,
    below: LevelIndex,
    work: Single,
    even: int,
    odd: int,
    plane: int,
    into: np.bool_,
) -> None:
    """Copy between a fine layer and a coarse plane (compiled).

    ``even`` and ``odd`` are where the fine layer is kept for even and odd spokes.
    """
    if at.coarsens_theta:
        # an even number of spokes has a ghost row of black nodes at hand
        more = 0 if into else 1 - at.n_theta % 2
        for spoke in range(below.n_theta + more):
            ends = (spoke, 2 * spoke)
            _swap(at, below, work, (even, plane), ends, into)
            if not at.coarsens_z:
                ends = (spoke, 2 * spoke + 1)
                _swap(at, below, work, (odd, plane), ends, into)
    else:
        for j in range(at.n_theta):
            source = odd if j % 2 else even
            _swap(at, below, work, (source, plane), (j, j), into)


@compiled(inline="always")
def _restrict_layer(
    at: LevelIndex,
    below: LevelIndex,
    fields: Single,
    work: Single,
    buffers: Buffers,
    i: int,
) -> None:
    """Residuals of fine layer i onto the coarse spokes and slices (compiled)."""
    width, q, zeros = at.width, at.pitch // 2, at.zeros
    red, black = i * width, (at.n_r + i) * width
    values, between, total = buffers.values, buffers.between, buffers.total
    if at.n_theta % 2 == 0:  # spoke -1 is the last one, unless their number is odd
        copy(work, values, values + at.n_theta * at.pitch // 2, q)
    odd = values
    if at.coarsens_z:
        after, before = at.after_z + black, at.before_z + black + 1
        mean = Mean(between, zeros, after, values, before, values + 1)
        _add_mean(work, fields, mean, width - 1)
        odd = between
    even = values
    if at.coarsens_theta and at.coarsens_z:
        copy(work, total, values, width + 2 * at.pitch)
        after, before = at.after_theta + red + 1, at.before_theta + red + 2 * q + 2
        out = total + q + 1
        mean = Mean(out, out, after, odd, before, odd + 2 * q + 1)
        _add_mean(work, fields, mean, width - 2 * q - 2)
        even = total
    elif at.coarsens_theta:
        after, before = at.after_theta + black, at.before_theta + black + at.pitch
        mean = Mean(total + at.pitch, zeros, after, odd, before, odd + at.pitch)
        _add_mean(work, fields, mean, width - at.pitch)
        odd = total
    _swap_plane(at, below, work, even, odd, buffers.plane, np.bool_(True))


@compiled(inner=True, nogil=True)
def restrict(
    at: LevelIndex, below: LevelIndex, fields: Single, work: Single, part: Part
) -> None:
    """Set the coarse right-hand side from the residual of black nodes (compiled).

    Args:
        at: The fine level; its residual is zero in ghost rows.
        below: The coarse level.
        fields: Coefficients.
        work: Vectors.
        part: Range of coarse layers; each part needs its own scratch arrays.
    """
    width = at.width
    buffers = _buffers(at, work)
    low, high = bounds(1, below.n_r - 1, part)
    for layer in range(low, high):
        i = 2 * layer if at.coarsens_r else layer
        row = at.residual + i * width
        if at.coarsens_r:
            black = (at.n_r + i) * width
            after, before = at.after_r + black - width, at.before_r + black + width
            mean = Mean(buffers.values, row, after, row - width, before, row + width)
            _add_mean(work, fields, mean, width)
        else:
            copy(work, buffers.values, row, width)
        _restrict_layer(at, below, fields, work, buffers, i)
        red = below.b + layer * below.width
        black = red + below.n_r * below.width
        if at.coarsens_z:
            _split(work, buffers.plane, red, black, below.width)
        else:
            copy(work, red, buffers.plane, below.width)
            copy(work, black, buffers.plane + below.width, below.width)


@compiled(inner=True, nogil=True, fastmath=FAST)
def _choose(work: Single, out: int, even: int, odd: int, is_odd: int, n: int) -> None:
    """Set ``odd`` where ``is_odd`` is 1, else ``even`` (compiled)."""
    to, first, second = np.uint64(out), np.uint64(even), np.uint64(odd)
    which = np.uint64(is_odd)
    for m in range(np.uint64(n)):
        value = work[first + m]
        work[to + m] = value + work[which + m] * (work[second + m] - value)


@compiled(inline="always")
def _prolong_layer(
    at: LevelIndex,
    below: LevelIndex,
    fields: Single,
    work: Single,
    buffers: Buffers,
    here: int,
    i: int,
) -> None:
    """Set ``here`` to one coarse layer at the places of fine layer i (compiled)."""
    width, q, zeros = at.width, at.pitch // 2, at.zeros
    red, black = i * width, (at.n_r + i) * width
    known, between = buffers.values, buffers.between
    _swap_plane(at, below, work, known, known, buffers.plane, np.bool_(False))
    odd = known
    if at.coarsens_theta and at.coarsens_z:
        before, after = at.before_theta + red + q + 1, at.after_theta + red + q + 1
        out = between + q + 1
        mean = Mean(out, zeros, before, known, after, known + 2 * q + 1)
        _add_mean(work, fields, mean, width - q - 1)
        odd = between
    elif at.coarsens_theta:
        before, after = at.before_theta + black, at.after_theta + black
        mean = Mean(between, zeros, before, known, after, known + at.pitch)
        _add_mean(work, fields, mean, width)
        odd = between
    if at.coarsens_z:
        before, after = at.before_z + black, at.after_z + black
        mean = Mean(here, zeros, before, odd, after, odd + 1)
        _add_mean(work, fields, mean, width)
        odd = here
    _choose(work, here, known, odd, buffers.is_odd, width)


@compiled(inner=True, nogil=True)
def prolong(
    at: LevelIndex, below: LevelIndex, fields: Single, work: Single, part: Part
) -> None:
    """Add the coarse correction to black nodes (compiled).

    Args:
        at: The fine level; its ghost rows are left alone.
        below: The coarse level, its ghost rows up to date.
        fields: Coefficients.
        work: Vectors.
        part: Range of coarse layers; each part needs its own scratch arrays.
    """
    width = at.width
    s, e = span(at, np.int64(1))
    buffers = _buffers(at, work)
    here, inner = buffers.here, buffers.below
    for j in range(-1, at.n_theta + 1, 2):
        start = buffers.is_odd + (j + 1) * at.pitch // 2
        fill(work, start, np.float32(1), at.pitch // 2)
    out = at.x + at.n_r * width + s
    low, high = bounds(1, below.n_r - 1, part)
    # the layer before a part once more: what lies between needs it
    for layer in range(max(1, low - at.coarsens_r), high):
        i = 2 * layer if at.coarsens_r else layer
        red = below.x + layer * below.width
        black = red + below.n_r * below.width
        if at.coarsens_z:
            _merge(work, buffers.plane, red, black, below.width)
        else:
            copy(work, buffers.plane, red, below.width)
            copy(work, buffers.plane + below.width, black, below.width)
        _prolong_layer(at, below, fields, work, buffers, here, i)
        if layer >= low:
            _add(work, out + i * width, here + s, e - s)
            if at.coarsens_r:
                _prolong_between(at, fields, work, i - 1, inner, here)
        if at.coarsens_r:
            inner, here = here, inner
    last = 2 * below.n_r - 3
    if at.coarsens_r and high == below.n_r - 1 and last < at.n_r - 1:
        _prolong_between(at, fields, work, last, inner, at.zeros)


@compiled(inner=True, nogil=True)
def _prolong_between(
    at: LevelIndex, fields: Single, work: Single, i: int, inner: int, outer: int
) -> None:
    """Add to fine layer i the mean of its neighbours (compiled)."""
    s, e = span(at, np.int64(1))
    p = (at.n_r + i) * at.width + s
    out = at.x + p
    mean = Mean(out, out, at.before_r + p, inner + s, at.after_r + p, outer + s)
    _add_mean(work, fields, mean, e - s)
