"""One V-cycle as a preconditioner, on vectors in red-black order.

A V-cycle costs a tenth of a solve if its right-hand side and answer are not copied to
whole grids in double precision and back. A caller that needs an approximate A⁻¹ at a
few voxels, many times over, writes and reads these vectors directly, on a part of the
grid if that suffices (`subdomain`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.laplace.multigrid.hierarchy import Hierarchy
from ttus_opt.laplace.multigrid.red_black import Single
from ttus_opt.laplace.multigrid.subdomain import Subdomain
from ttus_opt.laplace.multigrid.workspace import Workspace


class VCycle:
    """x ≈ A⁻¹ b by one V-cycle, b and x flat, in red-black order.

    The map is linear, symmetric and positive definite up to single precision. Each
    instance has its own arrays: several may run side by side.

    Attributes:
        b: Right-hand side, to be written to; zero at fixed voxels and in ghost rows,
            shape (n,).
        x: Answer of the last `run`, shape (n,).
        free: Free voxels of the subdomain, shape (V,).
    """

    def __init__(
        self,
        hierarchy: Hierarchy,
        subdomain: Subdomain,
        free: NDArray[np.bool_],
        *,
        sweeps: int = 1,
    ) -> None:
        """Allocate scratch arrays.

        Args:
            hierarchy: The levels of the subdomain.
            subdomain: The grid, or a part of it.
            free: Unknown voxels of the whole grid, shape (V,).
            sweeps: Sweeps before and after on the finest level [–].
        """
        self._layout = hierarchy.levels[0].layout
        self._subdomain, self._sweeps = subdomain, sweeps
        inside = subdomain.free(subdomain.grid.unflatten(free))
        self.free = subdomain.extend(inside)
        self._work = Workspace(hierarchy)
        self.b: Single = self._work.b.reshape(-1)
        self.x: Single = self._work.x.reshape(-1)

    def places(self, voxels: NDArray[np.integer]) -> NDArray[np.int64]:
        """Where voxels lie in ``b`` and ``x``.

        Args:
            voxels: Flat indices of voxels that are ``free`` here, shape (k,).

        Returns:
            Places, shape (k,).
        """
        return self._layout.places(self._subdomain.nodes(voxels))

    def run(self) -> None:
        """Set ``x`` to one V-cycle's answer for ``b``."""
        self._work.v_cycle(sweeps=self._sweeps)

    #: The map is symmetric
    run_adjoint = run
