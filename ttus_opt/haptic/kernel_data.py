"""Arrays of a haptic frame: probe and surface, which it reads, and scratch.

Everything that does not change between frames is prepared here once for the loops of
`ttus_opt.haptic.frame`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ttus_opt.contact.rows import shell_arrays
from ttus_opt.contact.shell_blocks import BLOCK, ShellBlocks, SurfaceCeiling
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.sampling import least_length, spoke_table
from ttus_opt.voxmap.voxmap import Voxmap

#: Most blocks processed at once, so that their scratch stays in the L1 cache
RUN = 8


#: Arrays of `FrameData` that a frame writes
SCRATCH = (
    *("place", "near", "node", "touched", "depth"),
    *("spot", "voxel", "share", "sampled", "hits"),
)


class FrameData(NamedTuple):
    """Input and scratch of the compiled passes, for one thread.

    Attributes:
        trilinear: Whether sampling is trilinear (or by size), not voxel-mean.
        points: Shell points in block order, probe frame, rows x, y, z, (3, M) [m].
        lever: Normal and r×n̂ about the reference point, probe axes, times the point's
            weight when trilinear, shape (M, 6) [–, m].
        reference: Reference point of torques, probe frame, shape (3,) [m].
        start: First point of each block, shape (B + 1,).
        spheres: Bounding spheres, rows x, y, z, radius, shape (4, B) [m].
        limits: `CylindricalGrid.kernel_limits` as an array, because tuples of numbers
            are slow to pass; then ℓ₀ of `contact_size`, 0 if size is ignored, (12,).
        shape: Voxel counts, shape (3,).
        radius: Radius at the surface's nodes, flat [m].
        nodes: Number of nodes over θ and z, shape (2,).
        layout: `Surface.kernel_layout`, shape (4,).
        spokes: `sampling.spoke_table`.
        ceiling: `SurfaceCeiling.ceiling`.
        tiles: `SurfaceCeiling.tiles`, shape (4,).
        place: Scratch: r², θ, z, the two coordinates within the surface cell, r and
            depth of points, shape (7, RUN·BLOCK), or (7, B) if that is larger.
        near: Scratch: blocks that may touch, shape (B,).
        node: Scratch: the surface cells of points, shape (2, …) as ``place``.
        touched: Out: indices of the points in contact, shape (M,).
        depth: Out: their depths below the surface, shape (M,) [m].
        spot: Out: their coordinates r, θ, z, shape (3, M) [m, rad, m].
        voxel: Out, voxel-mean only: the voxel of each, shape (M,).
        share: Out, voxel-mean only: its weight in the voxel's mean, shape (M,). By
            size: the first entry is 10 mm/ℓ.
        sampled: Scratch: samples of a field, shape (M,).
        hits: Scratch: points per voxel, zero between frames, shape (V,) or (1,).
    """

    trilinear: bool
    points: Array
    lever: Array
    reference: Array
    start: IntArray
    spheres: Array
    limits: Array
    shape: IntArray
    radius: Array
    nodes: IntArray
    layout: Array
    spokes: Array
    ceiling: Array
    tiles: Array
    place: Array
    near: NDArray[np.bool_]
    node: IntArray
    touched: IntArray
    depth: Array
    spot: Array
    voxel: IntArray
    share: Array
    sampled: Array
    hits: NDArray[np.int32]

    @classmethod
    def of(cls, voxmap: Voxmap, shell: PointShell, sampling: str) -> FrameData:
        """Prepare a probe and a voxmap for fields of a sampling."""
        trilinear = sampling != "voxel-mean"
        blocks = ShellBlocks.of(shell)
        above = SurfaceCeiling.of(voxmap.surface, float(blocks.reach.max()))
        points, normals, weights, reference = shell_arrays(shell)
        lever = np.concatenate([normals, np.cross(points - reference, normals)], axis=1)
        if trilinear:
            lever *= weights[:, None]
        n, width = len(points), max(RUN * BLOCK, len(blocks.reach))
        return cls(
            trilinear,
            np.ascontiguousarray(points[blocks.order].T),
            np.ascontiguousarray(lever[blocks.order]),
            reference,
            blocks.start,
            np.ascontiguousarray(np.column_stack([blocks.centre, blocks.reach]).T),
            np.array([*voxmap.grid.kernel_limits, least_length(sampling)]),
            np.array(voxmap.grid.shape),
            np.ascontiguousarray(voxmap.surface.radius).reshape(-1),
            np.array(voxmap.surface.radius.shape),
            np.array(voxmap.surface.kernel_layout),
            spoke_table(voxmap),
            above.ceiling,
            np.array(above.tiles),
            np.empty((7, width)),
            np.empty(len(blocks.reach), dtype=np.bool_),
            np.empty((2, width), dtype=np.int64),
            np.empty(n, dtype=np.int64),
            np.empty(n),
            np.empty((3, n)),
            np.empty(n, dtype=np.int64),
            np.empty(n),
            np.empty(n),
            np.zeros(1 if trilinear else voxmap.grid.n_voxels, dtype=np.int32),
        )

    def with_own_scratch(self) -> FrameData:
        """The same probe and surface with scratch for another thread."""
        own = {name: np.zeros_like(getattr(self, name)) for name in SCRATCH}
        return self._replace(**own)
