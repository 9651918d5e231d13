"""Conjugate gradients in single precision, preconditioned by a V-cycle (compiled).

As colour 0 follows exactly from colour 1, they run on colour 1 alone (the Schur
complement), unless an odd number of spokes spoils the chessboard; chains lie in lines
of one colour, which are solved exactly with all their ties, so that this holds for
them too. A correction is one call of compiled code: pieces of work on a small grid
take microseconds, and solves side by side would spend their time waiting for the
interpreter's lock.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ttus_opt.compiled import compiled
from ttus_opt.multigrid import kernels, line_smoother, transfer
from ttus_opt.multigrid.chains import Chains, Places, gather_half
from ttus_opt.multigrid.cycle import (
    Coarser,
    Hierarchy,
    Work,
    Workspace,
    cycle_below,
    direct,
    work_of,
)
from ttus_opt.multigrid.kernels import Numbers, Single

#: Conductances, inverse pivots, transfer weights, coarsened directions and sizes
Finest = tuple[
    Single, Single, Single, Single, tuple[Single, ...], tuple[bool, ...], Numbers
]

#: Places of the coarsest level's unknowns, inverse matrix
Bottom = tuple[NDArray[np.int64], Single]

#: The places of chains in both colours; None if there are none
Chained = tuple[Places, Places] | None

#: Direction, its image and the residual of one colour
Colour = tuple[Single, Single, Single]


class Vectors(Workspace):
    """What one solve writes to: conjugate gradients beside the V-cycle.

    Attributes:
        answer: Correction in halves, shape (2, n_r, width).
    """

    def __init__(
        self,
        hierarchy: Hierarchy,
        ties: tuple[Single, Chains] | None = None,
    ) -> None:
        """Take scratch arrays.

        Args:
            hierarchy: The levels.
            ties: Conductances to the next layer without ties, shape (n_r,), and who is
                tied; None where nobody is.
        """
        super().__init__(hierarchy)
        v = hierarchy.levels[0]
        # of ties nothing flows: all voxels of a chain have one value
        self._along = v.R if ties is None else ties[0]
        self._chained = None if ties is None else ties[1].places(v.layout)
        self._finest = (
            (v.R, v.T, v.Z, v.inverse, v.weights, v.flags, v.layout.numbers),
            (self.b[0], self.x[0], self.residual[0]),
        )
        self._below = (
            hierarchy.coarser,
            self.coarser,
            (hierarchy.places, hierarchy.inverse),
        )
        self.answer = np.zeros(v.shape, np.float32)
        self._one = tuple(np.zeros(v.shape[1:], np.float32) for _ in range(3))
        self._zero = None
        if v.is_odd:
            self._zero = tuple(np.zeros(v.shape[1:], np.float32) for _ in range(3))

    @property
    def memory_bytes(self) -> int:
        """Size of its arrays."""
        vectors = (self.answer, *self._one, *(self._zero or ()))
        return super().memory_bytes + sum(v.nbytes for v in vectors)

    def correct(self, goal: float, limit: int) -> int:
        """Solve A e = ``b[0]`` roughly, into ``answer``.

        Args:
            goal: Relative residual to reach [–].
            limit: Most V-cycles [–].

        Returns:
            V-cycles spent.
        """
        vectors = (self._along, self._chained, self.answer, self._zero, self._one)
        # 0 and 1 as values: numba would compile for every constant
        colours = (0, 1)
        return int(
            _correct(*self._finest, *self._below, *vectors, colours, goal, limit)
        )


@compiled(inline="always")
def _cycle(
    finest: Finest,
    work: Work,
    coarser: Coarser,
    lower: Single,
    bottom: Bottom,
    b0: Single | None,
    b1: Single,
    colours: tuple[int, int],
) -> None:
    """The V-cycle of `cycle.cycle`, without Python between its pieces (compiled)."""
    R, T, Z, inverse, weights, flags, numbers = finest
    places, inverted = bottom
    values, sizes = coarser
    zero, one = colours
    _, x, residual = work
    if len(sizes) == 0:
        direct(x, b0, b1, places, inverted, numbers)
    else:
        if numbers[0] % 2:
            x[:] = 0
        line_smoother.sweep_alone(x, b1, inverse[1], R, one, numbers)
        _sweep_zero(finest, x, b0, zero)
        kernels.couple(residual, x[0], np.float32(0), inverse[1], T, Z, numbers)
        coarse = (sizes[0, 6], sizes[0, 7], sizes[0, 8])
        load, below, _ = work_of(lower, sizes, 0)
        transfer.restrict(load, residual, weights, flags, numbers, coarse)
        cycle_below(values, sizes, lower, places, inverted)
        transfer.prolong(x[1], below, weights, flags, numbers, coarse)
        kernels.close_circle(x, one, numbers)
        _sweep_zero(finest, x, b0, zero)
        line_smoother.sweep(x, x[0], b1, inverse[1], R, T, Z, one, numbers)


@compiled(inline="always")
def _sweep_zero(finest: Finest, x: Single, b0: Single | None, zero: int) -> None:
    """Solve the lines of colour 0, given colour 1 (compiled)."""
    R, T, Z, inverse, _, _, numbers = finest
    if b0 is None:
        line_smoother.sweep_unloaded(x, x[1], inverse[0], R, T, Z, zero, numbers)
    else:
        line_smoother.sweep(x, x[1], b0, inverse[0], R, T, Z, zero, numbers)


@compiled(nogil=True)
def _correct(
    finest: Finest,
    work: Work,
    coarser: Coarser,
    lower: Single,
    bottom: Bottom,
    along: Single,
    chained: Chained,
    e: Single,
    zero: Colour | None,
    one: Colour,
    colours: tuple[int, int],
    goal: float,
    limit: int,
) -> int:
    """Solve A e = b roughly (compiled).

    Args:
        finest: The finest level.
        work: Its right-hand side b, correction and residual.
        coarser: What is below, see `Hierarchy`.
        lower: Its work.
        bottom: Its last level.
        along: Conductances to the next layer without ties, shape (n_r,).
        chained: Who is tied to whom on the finest level.
        e: Answer in halves.
        zero: Vectors of colour 0; None where it follows from colour 1.
        one: Vectors of colour 1.
        colours: 0 and 1.
        goal: Relative residual to reach [–].
        limit: Most V-cycles [–].

    Returns:
        V-cycles spent.
    """
    R, T, Z, inverse, _, _, numbers = finest
    b, x, _ = work
    c0, c1 = colours
    p, q, r = one
    e[:] = 0
    p[:] = 0
    if zero is None:
        line_smoother.sweep_alone(x, b[0], inverse[0], R, c0, numbers)
        kernels.couple(r, x[0], np.float32(0), inverse[1], T, Z, numbers)
        kernels.turn(r, b[1], np.float32(1))
    else:
        zero[0][:] = 0
        kernels.copy(zero[2], b[0])
        kernels.copy(r, b[1])
    if chained is not None:
        gather_half(r, chained[1])
        if zero is not None:
            gather_half(zero[2], chained[0])
    first = kernels.dot(r, r, c1, numbers)
    if zero is not None:
        first += kernels.dot(zero[2], zero[2], c0, numbers)
    spent, before = 0, math.inf
    while first > 0.0 and spent < limit:
        spent += 1
        if zero is None:
            _cycle(finest, work, coarser, lower, bottom, None, r, colours)
            rz = kernels.dot(r, x[1], c1, numbers)
            kernels.turn(p, x[1], np.float32(rz / before))
            line_smoother.sweep_unloaded(x, p, inverse[0], R, T, Z, c0, numbers)
            pq = kernels.operate(q, p, x[0], inverse[1], along, T, Z, c1, numbers)
        else:
            p0, q0, r0 = zero
            _cycle(finest, work, coarser, lower, bottom, r0, r, colours)
            rz = kernels.dot(r0, x[0], c0, numbers)
            rz += kernels.dot(r, x[1], c1, numbers)
            kernels.turn(p0, x[0], np.float32(rz / before))
            kernels.turn(p, x[1], np.float32(rz / before))
            pq = kernels.operate(q0, p0, p, inverse[0], along, T, Z, c0, numbers)
            pq += kernels.operate(q, p, p0, inverse[1], along, T, Z, c1, numbers)
        if not (pq > 0.0 and rz > 0.0):  # down to rounding
            break
        alpha = np.float32(rz / pq)
        now = kernels.step(e[1], r, p, q, alpha, c1, numbers)
        if zero is not None:
            now += kernels.step(e[0], zero[2], zero[0], zero[1], alpha, c0, numbers)
        if chained is not None:
            gather_half(r, chained[1])
            now = kernels.dot(r, r, c1, numbers)
            if zero is not None:
                gather_half(zero[2], chained[0])
                now += kernels.dot(zero[2], zero[2], c0, numbers)
        if now <= goal**2 * first:
            break
        before = rz
    if zero is None:
        kernels.close_circle(e, c1, numbers)
        line_smoother.sweep(e, e[1], b[0], inverse[0], R, T, Z, c0, numbers)
    return spent
