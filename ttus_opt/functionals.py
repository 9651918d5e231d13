"""The functionals of the field that measurements have touched.

A measured row is a sum of few voxel values, and measurements of one spot share their
voxels: rows are many, touched voxels few. So the unknowns are functionals φ of the
field: one voxel ("resolved"), or the part of a measured row at voxels that are not
resolved yet, a tail. Stacked, they are Φ, of k functionals over V voxels, and a block
of rows is D = C Φ with a sparse C: its values at resolved voxels, and 1 at its tail.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.errors import InputError

Array = NDArray[np.float64]
Voxels = NDArray[np.int32]
Slots = NDArray[np.int64]

#: Functionals for which there is room at first
ROOM = 64


@dataclass(frozen=True)
class Block:
    """Rows of one pose.

    Attributes:
        voxels: Flat indices, increasing, shape (j,).
        values: The rows' columns at these voxels, shape (j, m).
    """

    voxels: Voxels
    values: Array


@dataclass(frozen=True)
class Tail:
    """m functionals: a block's rows at the voxels that were not resolved.

    Attributes:
        within: Which of the block's voxels these are, shape (j,).
        part: The rows there, of i voxels.
        slots: Numbers of the functionals, shape (m,); changed in place when others go.
    """

    within: NDArray[np.bool_]
    part: Block
    slots: Slots


@dataclass(frozen=True)
class Combination:
    """C: a block of rows as sums of functionals.

    Attributes:
        slots: Numbers of the functionals, shape (i,).
        values: What stands before them in each row, shape (i, m).
    """

    slots: Slots
    values: Array


class Functionals:
    """Φ as it grows and shrinks; functional i is row i.

    Args:
        n_voxels: V [–].
    """

    def __init__(self, n_voxels: int) -> None:
        self._slot = np.full(n_voxels, -1, dtype=np.int32)
        # voxel of every functional, -1 for those of tails
        self._voxel = np.full(ROOM, -1, dtype=np.int32)
        self._size = 0
        self._tails: list[Tail] = []

    def __len__(self) -> int:
        """Number of functionals k [–]."""
        return self._size

    @property
    def tails(self) -> tuple[Tail, ...]:
        """Tails there are, the oldest first."""
        return tuple(self._tails)

    @property
    def memory_bytes(self) -> int:
        """Size of what grows with the functionals."""
        tails = sum(
            t.part.values.nbytes + t.part.voxels.nbytes + t.within.nbytes
            for t in self._tails
        )
        return self._voxel.nbytes + tails

    def unresolved(self, voxels: Voxels) -> NDArray[np.bool_]:
        """Which of these voxels are no functional yet.

        Raises:
            InputError: A voxel that is not there.
        """
        if len(voxels) and not 0 <= voxels.min() <= voxels.max() < len(self._slot):
            raise InputError(f"voxels must lie in 0 to {len(self._slot) - 1}")
        return self._slot[voxels] < 0

    def resolve(self, voxels: Voxels) -> None:
        """Add one functional per voxel, behind those there are."""
        first, last = self._size, self._size + len(voxels)
        self._grow(last)
        self._voxel[first:last] = voxels
        self._slot[voxels] = np.arange(first, last)

    def add_tail(self, block: Block, within: NDArray[np.bool_]) -> Tail:
        """Add a block's rows at some of its voxels as functionals of their own.

        Args:
            block: The rows.
            within: At which of its voxels, shape (j,).
        """
        first, m = self._size, block.values.shape[1]
        self._grow(first + m)
        self._voxel[first : first + m] = -1
        part = Block(block.voxels[within], block.values[within])
        tail = Tail(within, part, np.arange(first, first + m))
        self._tails.append(tail)
        return tail

    def drop_tail(self, tail: Tail) -> Slots:
        """Take a tail out.

        Returns:
            The numbers that became free, decreasing; into each, one after the other,
            the functional that was then the last has moved.
        """
        # by identity: equality of arrays is no truth value
        self._tails = [t for t in self._tails if t is not tail]
        gone = np.sort(tail.slots)[::-1].copy()
        for slot in gone:
            last = self._size - 1
            voxel = self._voxel[last]
            self._voxel[slot] = voxel
            if voxel >= 0:
                self._slot[voxel] = slot
            elif slot != last:
                for other in self._tails:
                    other.slots[other.slots == last] = slot
            self._size = last
        return gone

    def combination(self, block: Block, tail: Tail | None, scale: float) -> Combination:
        """C of a block.

        Args:
            block: Its rows; voxels outside its tail must be resolved.
            tail: Its tail, if it has one.
            scale: What the rows have been multiplied by since the tail was made [–].
        """
        if tail is None:
            return Combination(self._slot[block.voxels].astype(np.int64), block.values)
        own = self._slot[block.voxels[~tail.within]]
        m = block.values.shape[1]
        return Combination(
            np.concatenate([own, tail.slots]),
            np.concatenate([block.values[~tail.within], scale * np.eye(m)]),
        )

    def of(self, x: Array) -> Array:
        """Φ x.

        Args:
            x: One number per voxel, shape (V,).

        Returns:
            Shape (k,).
        """
        # -1 reads some voxel: tails are written over it
        out: Array = x[self._voxel[: self._size]]
        for tail in self._tails:
            out[tail.slots] = x[tail.part.voxels] @ tail.part.values
        return out

    def adjoint(self, u: Array) -> Array:
        """Φᵀ u.

        Args:
            u: One number per functional, shape (k,).

        Returns:
            Shape (V,).
        """
        out = np.zeros(len(self._slot))
        voxels = self._voxel[: self._size]
        single = voxels >= 0
        out[voxels[single]] = u[single]
        for tail in self._tails:
            out[tail.part.voxels] += tail.part.values @ u[tail.slots]
        return out

    def _grow(self, size: int) -> None:
        """Make room for as many functionals, by doubling, and note their number."""
        if size > len(self._voxel):
            bigger = np.full(max(2 * len(self._voxel), size), -1, dtype=np.int32)
            bigger[: self._size] = self._voxel[: self._size]
            self._voxel = bigger
        self._size = size
