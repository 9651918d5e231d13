"""A preconditioner for the dual system from a coarser grid.

Halving the grid in θ and z, where the field is smooth, leaves K all but unchanged
(cosine of K r and K_c r 0.999 on case M); halving it in r would move the surface
layer. A few Lanczos steps with the coarse K_c, each a fraction of a fine one, find
the measured directions that make the system stiff:

    (I + K)⁻¹ ≈ I - V T (I + T)⁻¹ Vᵀ,   T = Vᵀ K_c V.

They stop by themselves when what is left of K_c is below the identity, after 3 steps
for light weights and 150 for heavy ones: there is nothing to choose.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.grid import CylindricalGrid
from ttus_opt.laplace import LaplaceSystem
from ttus_opt.solvers.dual_system import DualSystem
from ttus_opt.voxmap import Voxmap

Array = NDArray[np.float64]

#: Relative residual of coarse solves
RTOL = 1e-6

#: Lanczos stops when this many steps in a row find less of K than the identity
QUIET_STEPS = 3

#: Most Lanczos steps
MAX_STEPS = 300


def coarse_preconditioner(system: DualSystem, start: Array) -> Callable[[Array], Array]:
    """An approximation of (I + K)⁻¹, symmetric positive definite.

    Args:
        system: The fine dual system.
        start: Where Lanczos starts: the right side, shape (m,).

    Returns:
        A function from (m,) to (m,); the identity where the grid is too small to be
        halved or there is nothing to start from.
    """
    grid = system.laplace.grid
    shape = (grid.shape[0], grid.shape[1] // 2, grid.shape[2] // 2)
    if min(shape) < 4 or not np.any(start):
        return lambda y: y.copy()
    basis, T = _lanczos(_coarse_system(system, shape), start)
    middle = np.linalg.solve(np.eye(len(T)) + T, T)
    middle = (middle + middle.T) / 2.0
    return lambda y: y - (middle @ (basis @ y)) @ basis


def _coarse_system(system: DualSystem, shape: tuple[int, int, int]) -> DualSystem:
    """The same measurements on a coarser grid.

    Row by row, Δr² ∇²p is the same number on both grids (Δr is kept), but there are
    fewer rows: ω is scaled by the ratio of their counts, free and fixed apart.
    """
    fine = system.laplace
    grid = fine.grid
    voxmap = Voxmap.from_surface(
        fine.voxmap.surface,
        shape=shape,
        r_inner=grid.r_inner,
        r_outer=grid.r_outer,
    )
    laplace = LaplaceSystem.assemble(voxmap)
    softness = np.empty(voxmap.grid.n_voxels)
    for mine, theirs in ((laplace.free, fine.free), (~laplace.free, ~fine.free)):
        # the mean softness of the kind, over fewer rows
        softness[mine] = system.softness[theirs].sum() / max(theirs.sum(), 1)
        softness[mine] *= mine.sum() / max(theirs.sum(), 1)
    touched = np.unique(system.rows.indices)
    rows = sp.csr_array(system.rows[:, touched] @ _prolongation(grid, touched, voxmap))
    return DualSystem(laplace, softness, rows, system.root_weights)


def _prolongation(
    fine: CylindricalGrid, voxels: NDArray[np.int32], coarse: Voxmap
) -> sp.csr_array:
    """Bilinear interpolation in θ and z from the coarse grid to some fine voxels."""
    grid = coarse.grid
    i, j, k = np.unravel_index(voxels, fine.shape)
    u = fine.theta[j] / grid.theta_step
    w = (fine.z[k] - grid.z_min) / grid.z_step
    j0, k0 = u.astype(np.int64), np.minimum(w.astype(np.int64), grid.shape[2] - 2)
    u, w = u - j0, w - k0
    columns, values = [], []
    for dj, share_j in ((0, 1.0 - u), (1, u)):
        for dk, share_k in ((0, 1.0 - w), (1, w)):
            at = (i, (j0 + dj) % grid.shape[1], k0 + dk)
            columns.append(np.ravel_multi_index(at, grid.shape))
            values.append(share_j * share_k)
    row = np.tile(np.arange(len(voxels)), 4)
    return sp.csr_array(
        (np.concatenate(values), (row, np.concatenate(columns))),
        shape=(len(voxels), grid.n_voxels),
    )


def _lanczos(system: DualSystem, start: Array) -> tuple[Array, Array]:
    """Lanczos on K with full reorthogonalisation.

    Returns:
        Orthonormal basis (k, m) and T (k, k).
    """
    basis = (start / np.linalg.norm(start))[None]
    diagonal: list[float] = []
    beside: list[float] = []
    limit = min(MAX_STEPS, len(start))
    while True:
        image = system.apply(basis[-1], RTOL) - basis[-1]
        diagonal.append(float(image @ basis[-1]))
        for _ in range(2):
            image = image - (basis @ image) @ basis
        size = float(np.linalg.norm(image))
        quiet = len(diagonal) >= QUIET_STEPS and max(diagonal[-QUIET_STEPS:]) < 1.0
        if quiet or len(diagonal) == limit or size <= 1e-12 * max(diagonal):
            T = np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1)
            return basis, T
        beside.append(size)
        basis = np.vstack([basis, image / size])
