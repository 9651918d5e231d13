"""One V-cycle on arrays in the multigrid's own order: A⁻¹ roughly, and fast.

A single V-cycle costs a tenth of a solve, as long as its right-hand side and answer
are not copied to whole grids of double precision and back. Who needs A⁻¹ roughly at
some voxels only, many times over, writes and reads these halves directly, and may do
with a part of the grid (`window`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.multigrid.cycle import Hierarchy, Workspace, cycle
from ttus_opt.multigrid.kernels import Single
from ttus_opt.multigrid.subdomain import Window
from ttus_opt.voxmap.grid import CylindricalGrid


class VCycle:
    """x ≈ A⁻¹ b by one V-cycle, b and x flat and in halves (see `levels`).

    The map is linear, symmetric and positive definite up to single precision. It
    works in arrays of its own: several may run side by side.

    Attributes:
        b: Right-hand side, to be written to; zero at fixed voxels and where the
            circle closes, shape (n,).
        x: Answer of the last `run`, shape (n,).
        free: Unknown voxels that it knows of, shape (V,).
    """

    def __init__(
        self,
        hierarchy: Hierarchy,
        window: Window,
        free: NDArray[np.bool_],
        *,
        sweeps: int = 1,
    ) -> None:
        """Take scratch arrays.

        Args:
            hierarchy: The levels of the window.
            window: The grid, or a part of it.
            free: Unknown voxels of the whole grid, shape (V,).
            sweeps: On the finest level, see `cycle` [–].
        """
        self._hierarchy, self._window, self._sweeps = hierarchy, window, sweeps
        self.free = window.spread(window.free(window.grid.unflatten(free)))
        self._work = Workspace(hierarchy)
        self.b: Single = self._work.b[0].reshape(-1)
        self.x: Single = self._work.x[0].reshape(-1)

    @classmethod
    def near(
        cls,
        voxels: NDArray[np.integer] | None,
        hierarchy: Hierarchy,
        grid: CylindricalGrid,
        free: NDArray[np.bool_],
        ties: NDArray[np.bool_] | None = None,
    ) -> VCycle:
        """As exact as one V-cycle can be at some voxels, and no larger than needed.

        Args:
            voxels: Flat indices, shape (k,); None for all, and the plain V-cycle.
            hierarchy: The levels of the whole grid.
            grid: The grid.
            free: Its unknown voxels, shape (V,).
            ties: Those that move with the next one outwards, shape (V,); None for none.
        """
        window = Window.around(grid, voxels)
        if not window.is_whole:
            inside = window.free(grid.unflatten(free))
            tied = None if ties is None else window.cut(grid.unflatten(ties))
            hierarchy = Hierarchy.build(window, inside, tied)
        return cls(hierarchy, window, free, sweeps=1 if voxels is None else 2)

    def places(self, voxels: NDArray[np.integer]) -> NDArray[np.int64]:
        """Where voxels lie in ``b`` and ``x``.

        Args:
            voxels: Flat indices of voxels that are ``free`` here, shape (k,).

        Returns:
            Places, shape (k,).
        """
        layout = self._hierarchy.levels[0].layout
        return layout.places(self._window.nodes(voxels))

    def run(self) -> None:
        """Set ``x`` to one V-cycle's answer for ``b``."""
        b = self._work.b[0]
        cycle(self._hierarchy, self._work, (b[0], b[1]), sweeps=self._sweeps)

    def run_adjoint(self) -> None:
        """The same, as the map is symmetric."""
        self.run()
