"""Multilevel cubic prediction with an error bound (docs/method/rendering.md, 17.1).

A regular array is sent from coarse to fine. Each pass halves the step of one axis; the
new nodes are predicted by cubic interpolation of those already *decoded*, and only the
rounded difference is sent, so that errors do not accumulate. After Zhao and others,
Optimizing error-bounded lossy compression for scientific data by dynamic spline
interpolation, ICDE 2021.

All arithmetic is in integers: sender and receiver agree to the last bit on any machine.

An array with a kink at a surface is predicted separately on either side.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, IntArray

#: Resolution of predictions [parts per quantum]
PARTS = 256

#: Denominator of the weights of interpolation
WEIGHT = 4096

#: Nodes of a stencil, and of one whose nodes all lie on one side of the predicted node,
#: where more would amplify rounding
STENCIL, STENCIL_BEYOND = 4, 2

#: A quantum in units of the error bound: half a quantum, and half a part of rounding
QUANTUM = 2 * PARTS / (PARTS + 1)

#: Largest difference, in 32 bits
LARGEST = 2**31 - 1

#: Indices per axis
_Indices = tuple[IntArray, ...]


@dataclass(frozen=True)
class Scheme:
    """Order and resolution in which an array is sent.

    Attributes:
        shape: Shape of the array.
        periodic: Which axes are periodic.
        axes: Order in which a level refines them; the best predicted one comes last.
        divisors: Fractions of a quantum to which differences are rounded, from the
            finest level to coarser ones, the last for all beyond; predictions from
            more exact values leave smaller differences.
        sides: Side of a surface on which every node lies, of the array's shape; a node
            is predicted from those on its side. On positive sides the array is 0 at the
            surface, so that the middle two of four nodes count as 0 beyond it. None
            where there is no surface.
    """

    shape: tuple[int, ...]
    periodic: tuple[bool, ...]
    axes: tuple[int, ...]
    divisors: tuple[int, ...] = (1,)
    sides: NDArray[np.int8] | None = field(default=None, repr=False, compare=False)

    def passes(self) -> Iterator[_Pass]:
        """The passes from coarse to fine; the first has no prediction."""
        step = 1
        while STENCIL * step < max(self.shape):
            step *= 2
        level = step.bit_length() - 1
        known = [np.arange(0, n, 2 * step) for n in self.shape]
        yield _Pass(tuple(known), self._parts(level + 1))
        while level >= 0:
            for axis in self.axes:
                n = self.shape[axis]
                new = np.arange(step, n, 2 * step)
                if len(new) == 0:
                    continue
                stencils = _stencils(n, step, self.periodic[axis])
                target = (*known[:axis], new, *known[axis + 1 :])
                parts = self._parts(level)
                yield _Pass(target, parts, axis, tuple(known), stencils)
                known[axis] = np.arange(0, n, step)
            step //= 2
            level -= 1

    def _parts(self, level: int) -> int:
        """Parts of one difference on a level, 0 being the finest."""
        return PARTS // self.divisors[min(level, len(self.divisors) - 1)]


@dataclass(frozen=True)
class _Stencils:
    """Stencils of new nodes along an axis.

    Attributes:
        nodes: Indices along the axis, shape (new, count).
        kind: Row of ``weights`` for every new node, shape (new,).
        weights: Per kind and per subset of usable nodes, bit i for node i, shape
            (kinds, 2**count, count) [1/`WEIGHT`].
    """

    nodes: IntArray
    kind: IntArray
    weights: IntArray


@dataclass(frozen=True)
class _Pass:
    """Nodes of one pass, predicted along one axis.

    Attributes:
        target: Their indices, per axis.
        parts: Parts of a quantum in one difference.
        axis: The axis.
        known: Indices known so far, per axis.
        stencils: Stencils of the nodes; None for the coarsest pass.
    """

    target: _Indices
    parts: int
    axis: int = 0
    known: _Indices = ()
    stencils: _Stencils | None = None

    def predicted(self, values: IntArray, sides: NDArray[np.int8] | None) -> IntArray:
        """The predicted nodes, rounded; 0 where no known node is usable."""
        shape = [len(indices) for indices in self.target]
        if self.stencils is None:
            return np.zeros(shape, np.int64)
        nodes = [self._there(node) for node in self.stencils.nodes.T]
        known = [values[node] for node in nodes]
        usable: IntArray | int = (1 << len(nodes)) - 1
        if sides is not None:
            known, usable = self._on_one_side(known, sides, nodes)
        along = [1] * values.ndim
        along[self.axis] = -1
        weights = self.stencils.weights[self.stencils.kind.reshape(along), usable]
        total = np.full(shape, WEIGHT // 2)
        for number, part in enumerate(known):
            total += part * weights[..., number]
        return np.asarray(total // WEIGHT)

    def _on_one_side(
        self, known: list[IntArray], sides: NDArray[np.int8], nodes: list[_Indices]
    ) -> tuple[list[IntArray], IntArray]:
        """Values of nodes, 0 on other sides, and usable nodes: bit i for node i."""
        side = sides[np.ix_(*self.target)]
        usable = np.zeros(side.shape, np.int64)
        seen = []
        for bit, node in enumerate(nodes):
            same = sides[node] == side
            seen.append(np.where(same, known[bit], 0))
            nearest = len(known) // 2 - 1 <= bit <= len(known) // 2
            usable |= (same | (side > 0) if nearest else same).astype(np.int64) << bit
        return seen, usable

    def _there(self, node: IntArray) -> _Indices:
        """Indices of known nodes, with others along the axis."""
        across = [*self.known]
        across[self.axis] = node
        return np.ix_(*across)


@functools.lru_cache(maxsize=256)
def _stencils(n: int, step: int, periodic: bool) -> _Stencils:
    """Stencils of up to four nodes, exact for cubic polynomials.

    Args:
        n: Nodes along the axis.
        step: Even multiples of it are known, odd multiples are predicted.
        periodic: Whether the axis is periodic.
    """
    known, new = np.arange(0, n, 2 * step), np.arange(step, n, 2 * step)
    around = np.concatenate([known - n, known, known + n]) if periodic else known
    count = min(STENCIL, len(around))
    nodes = np.empty((len(new), count), np.int64)
    kinds: dict[tuple[int, ...], int] = {}
    kind = np.empty(len(new), np.int64)
    for row, index in enumerate(new):
        first = int(np.searchsorted(around, index)) - count // 2
        chosen = around[max(0, min(first, len(around) - count)) :][:count]
        offsets = tuple(int(v) for v in chosen - index)
        nodes[row], kind[row] = chosen % n, kinds.setdefault(offsets, len(kinds))
    return _Stencils(nodes, kind, np.array([_weights(each) for each in kinds]))


def _weights(offsets: Sequence[int]) -> IntArray:
    """Weights for the value at 0, per node subset, (2**count, count) [1/`WEIGHT`]."""
    count = len(offsets)
    out = np.zeros((1 << count, count), np.int64)
    for subset in range(1, 1 << count):
        chosen = [i for i in range(count) if subset >> i & 1]
        if offsets[chosen[0]] > 0 or offsets[chosen[-1]] < 0:
            chosen.sort(key=lambda i: abs(offsets[i]))
            chosen = chosen[:STENCIL_BEYOND]
        out[subset, chosen] = _lagrange([offsets[i] for i in chosen])
    return out


def _lagrange(offsets: Sequence[int]) -> list[int]:
    """Lagrange weights of values at some offsets for the value at 0 [1/`WEIGHT`]."""
    weights = []
    for i, own in enumerate(offsets):
        others = [other for j, other in enumerate(offsets) if j != i]
        weight = Fraction(WEIGHT)
        for other in others:
            weight *= Fraction(-other, own - other)
        weights.append(round(weight))
    weights[len(offsets) // 2] += WEIGHT - sum(weights)
    return weights


def differences(
    values: Array, max_error: float, scheme: Scheme
) -> tuple[list[IntArray], Array]:
    """The differences that encode an array.

    Args:
        values: The array, of the scheme's shape.
        max_error: Largest error of a decoded value, in the unit of the values.
        scheme: Order of sending.

    Returns:
        Differences of each pass, flat, and the decoded array.

    Raises:
        OverflowError: The bound is so small that a difference exceeds 32 bits.
    """
    part = QUANTUM * max_error / PARTS
    if not float(np.abs(values).max(initial=0.0)) / part < LARGEST * PARTS:
        raise OverflowError
    exact = np.rint(values / part).astype(np.int64)
    sent: list[IntArray] = []

    def difference(target: _Indices, predicted: IntArray, parts: int) -> IntArray:
        rest = exact[np.ix_(*target)] - predicted
        sent.append((rest + parts // 2) // parts)
        return sent[-1]

    decoded = _refined(scheme, difference)
    if max(np.abs(some).max(initial=0) for some in sent) > LARGEST:
        raise OverflowError
    return [some.reshape(-1) for some in sent], np.asarray(decoded * part, np.float64)


def restored(sent: IntArray, max_error: float, scheme: Scheme) -> Array:
    """The array from the differences of all passes, shape (scheme.size,)."""
    at = 0

    def difference(target: _Indices, predicted: IntArray, parts: int) -> IntArray:
        nonlocal at
        shape = tuple(len(indices) for indices in target)
        here = sent[at : at + math.prod(shape)].reshape(shape)
        at += here.size
        return here

    return np.asarray(_refined(scheme, difference) * (QUANTUM * max_error / PARTS))


def _refined(
    scheme: Scheme, difference: Callable[[_Indices, IntArray, int], IntArray]
) -> IntArray:
    """Values [parts], pass by pass.

    Args:
        scheme: Order of sending.
        difference: Gives the differences of a pass from its target, the prediction and
            the parts of one difference.
    """
    values = np.zeros(scheme.shape, np.int64)
    for step in scheme.passes():
        predicted = step.predicted(values, scheme.sides)
        rest = step.parts * difference(step.target, predicted, step.parts)
        values[np.ix_(*step.target)] = predicted + rest
    return values
