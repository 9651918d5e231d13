"""One V-cycle on arrays in the multigrid's own order: A⁻¹ roughly, and fast.

A single V-cycle costs a tenth of a solve, as long as its right-hand side and answer
are not copied to whole grids of double precision and back. Who needs A⁻¹ roughly at
some voxels only, many times over, writes and reads these halves directly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.multigrid.cycle import Hierarchy, Workspace, cycle
from ttus_opt.multigrid.kernels import Single


class VCycle:
    """x ≈ A⁻¹ b by one V-cycle, b and x flat and in halves (see `levels`).

    The map is linear, symmetric and positive definite up to single precision. It
    works in arrays of its own: several may run side by side.

    Attributes:
        b: Right-hand side, to be written to; zero at fixed voxels and where the
            circle closes, shape (n,).
        x: Answer of the last `run`, shape (n,).
    """

    def __init__(self, hierarchy: Hierarchy, shape: tuple[int, int, int]) -> None:
        """Take scratch arrays.

        Args:
            hierarchy: The levels.
            shape: Of the grid.
        """
        self._hierarchy, self._shape = hierarchy, shape
        self._work = Workspace(hierarchy)
        self.b: Single = self._work.b[0].reshape(-1)
        self.x: Single = self._work.x[0].reshape(-1)

    def places(self, voxels: NDArray[np.integer]) -> NDArray[np.int64]:
        """Where voxels lie in ``b`` and ``x``.

        Args:
            voxels: Flat indices of free voxels, shape (k,).

        Returns:
            Places, shape (k,).
        """
        layout = self._hierarchy.levels[0].layout
        return layout.places(np.unravel_index(voxels, self._shape))

    def run(self) -> None:
        """Set ``x`` to one V-cycle's answer for ``b``."""
        b = self._work.b[0]
        cycle(self._hierarchy, self._work, (b[0], b[1]))

    def run_adjoint(self) -> None:
        """The same, as the map is symmetric."""
        self.run()
