"""A square L with rough solves: one V-cycle where `LaplaceSystem` solves exactly."""

from __future__ import annotations

from dataclasses import dataclass, field

import scipy.sparse as sp

from ttus_opt.arrays import Array, Mask
from ttus_opt.laplace.square_system import BlockSolves, SquareSystem
from ttus_opt.multigrid.one_cycle import OneCycle


@dataclass(frozen=True)
class ApproximateLaplace(BlockSolves):
    """A square system whose solves are one V-cycle each, linear and adjoint.

    Attributes:
        free: Voxels with an unknown of their own, shape (V,).
        radii: What turns a row of A into one of L, shape (V,) [m].
        coupling: Entries from fixed voxels to free rows, and their adjoint.
        multigrid: The V-cycle of A, with what is added to it.
    """

    free: Mask = field(repr=False)
    radii: Array = field(repr=False)
    coupling: tuple[sp.csr_array, sp.csr_array] = field(repr=False)
    multigrid: OneCycle = field(repr=False)

    @classmethod
    def of(cls, system: SquareSystem, multigrid: OneCycle) -> ApproximateLaplace:
        """The same system with another block A."""
        return cls(system.free, system.radii, system.coupling, multigrid)
