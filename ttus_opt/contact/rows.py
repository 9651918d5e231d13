"""Contact rows: force and torque as linear maps of the field (paper eqs. 6, 7).

For each pose, the shell points inside the patient sample the field in one of three
ways, all linear in p (docs/method/contact.md, Contact rows):

- ``voxel-mean`` (the paper): f = Σ_v n̄(v) p(v), with n̄(v) the mean of the normals of
  the points in voxel v, and τ = Σ_v w̄(v) p(v) with w̄(v) the mean of their r×n̂;
  points too close to the surface to sample their voxel do not count in its means.
- ``trilinear``: f = Σ_m (a_m/A₀) n̂_m p(x_m), p(x_m) interpolated, A₀ = 1 cm².
- ``contact-size``: the same times 10 mm/ℓ, ℓ the length of the contact patch, at least
  ℓ₀ (`ttus_opt.contact.contact_size`, `ttus_opt.voxmap.sampling`).

The rows here and the frames of `ttus_opt.haptic.renderer` sample by the same functions
(`ttus_opt.voxmap.sampling`), so ``render(pose) == N(pose) p``. Beyond the inner layer
the field continues with that layer's values. Points outside the patient, or beyond the
grid's ends in z or θ, sample nothing; depths fade over the last voxel in z.
`PoseRows` are force rows as functions of the poses, and their derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.contact.contact_size import Patches, patch_factors
from ttus_opt.contact.row_kernels import REFERENCE_AREA as REFERENCE_AREA
from ttus_opt.contact.row_kernels import TRILINEAR, VOXEL_MEAN, Poses, walked
from ttus_opt.contact.row_kernels import beside as beside
from ttus_opt.contact.row_kernels import rotated as rotated
from ttus_opt.contact.row_kernels import shell_arrays as shell_arrays
from ttus_opt.contact.row_kernels import within as within
from ttus_opt.contact.slip import Slip
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import InputError
from ttus_opt.probe.cylindrical import turn_angle as turn_angle
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.pose import rotations
from ttus_opt.probe.tracker_noise import TrackerNoise
from ttus_opt.voxmap.sampling import check_sampling, least_length
from ttus_opt.voxmap.voxmap import Voxmap

Sampling = Literal["voxel-mean", "trilinear", "contact-size"]


@dataclass(frozen=True)
class ContactRows:
    """Measurement matrices of a trajectory of T poses.

    Rows 3t, 3t+1, 3t+2 are x, y, z of pose t. N and W share their column indices.

    Attributes:
        N: Force rows, f = N p, shape (3T, V).
        W: Torque rows about the shell's reference point, τ = W p, (3T, V) [m].
        contact_points: Shell points inside the patient, shape (T,) [–].
        in_grid: False where no shell point lies within the grid, shape (T,).
        beyond_inner: Points in contact beyond the inner layer, shape (T,) [–].
        patches: Contact patches of the poses.
    """

    N: sp.csr_array = field(repr=False)
    W: sp.csr_array = field(repr=False)
    contact_points: NDArray[np.int64]
    in_grid: NDArray[np.bool_]
    beyond_inner: NDArray[np.int64]
    patches: Patches = field(repr=False)

    @property
    def touching(self) -> Mask:
        """Frames in contact, shape (T,)."""
        return np.asarray(self.contact_points > 0)

    def scaled(self, factor: Array) -> ContactRows:
        """The rows of every pose times a factor, shape (T,)."""
        N, W = (scaled_rows(rows, np.repeat(factor, 3)) for rows in (self.N, self.W))
        return replace(self, N=N, W=W)

    def __repr__(self) -> str:
        return (
            f"ContactRows({len(self.in_grid)} poses, {self.touching.sum()} in contact, "
            f"{self.N.shape[1]:,} voxels)"
        )


def scaled_rows(matrix: sp.csr_array, factor: Array) -> sp.csr_array:
    """A matrix (m, n) with every row times a factor, shape (m,)."""
    data = matrix.data * np.repeat(factor, np.diff(matrix.indptr))
    out = sp.csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)
    out.has_sorted_indices = matrix.has_sorted_indices
    return out


def diagonal_blocks(blocks: Array) -> sp.csr_array:
    """The matrix (n a, n b) with blocks of shape (n, a, b) on its diagonal."""
    n, a, b = blocks.shape
    starts = np.arange(n + 1)
    return sp.csr_array(sp.bsr_array((blocks, starts[:-1], starts), (a * n, b * n)))


def checked_poses(rotation: Array, position: Array) -> tuple[Array, Array]:
    """Poses as contiguous arrays (T, 3, 3) and (T, 3), rounding corrected.

    Raises:
        InputError: Wrong shapes, values that are not finite, or matrices that are not
            rotations.
    """
    rotation = np.ascontiguousarray(rotation, dtype=np.float64)
    position = np.ascontiguousarray(position, dtype=np.float64)
    if position.ndim != 2 or position.shape[1] != 3:
        raise InputError(f"positions must be (T, 3) [m], got {position.shape}")
    if rotation.shape != (len(position), 3, 3):
        raise InputError(
            f"rotations must be ({len(position)}, 3, 3), got {rotation.shape}"
        )
    if not np.isfinite(position).all():
        raise InputError("positions contain NaN or infinite values: drop those frames")
    return np.ascontiguousarray(rotations(rotation)), position


def contact_rows(
    voxmap: Voxmap,
    shell: PointShell,
    rotation: Array,
    position: Array,
    *,
    sampling: str = "voxel-mean",
    slip: Slip | None = None,
) -> ContactRows:
    """Assemble N and W for a whole trajectory.

    Args:
        voxmap: Grid and surface.
        shell: The probe's point shell.
        rotation: Probe to patient, shape (T, 3, 3) [–].
        position: Origin of the probe frame, patient frame, shape (T, 3) [m].
        sampling: ``voxel-mean``, ``trilinear`` or ``contact-size``.
        slip: Sliding of the points, for rows of drag (`contact.point_drag`) instead of
            contact.

    Raises:
        InputError: Unknown sampling or unusable poses.
    """
    check_sampling(sampling)
    rotation, position = checked_poses(rotation, position)
    shape, least = (3 * len(position), voxmap.grid.n_voxels), least_length(sampling)
    poses = Poses(rotation, position, Slip.none() if slip is None else slip)
    kind = VOXEL_MEAN if sampling == "voxel-mean" else TRILINEAR
    rows = walked(voxmap, shell, poses, kind)
    used = rows.row_ptr[-1]
    matrices = []
    columns = rows.columns[:used].copy()
    for data in (rows.force, rows.torque):
        matrix = sp.csr_array((data[:used].copy(), columns, rows.row_ptr), shape=shape)
        matrix.has_sorted_indices = True
        matrices.append(matrix)
    counts = (rows.contact_points, rows.in_grid, rows.beyond_inner)
    found = ContactRows(matrices[0], matrices[1], *counts, Patches.of(rows))
    return found.scaled(patch_factors(rows.spread, least)) if least else found


@dataclass(frozen=True)
class PoseRows:
    """Rows N of contact without drag.

    Attributes:
        voxmap: Grid and surface.
        shell: The probe.
        sampling: Of the field.
    """

    voxmap: Voxmap
    shell: PointShell = field(repr=False)
    sampling: str

    def at(self, rotation: Array, position: Array) -> sp.csr_array:
        """The rows at poses (T, 3, 3) and (T, 3), shape (3T, V)."""
        at = self.voxmap, self.shell, rotation, position
        return contact_rows(*at, sampling=self.sampling).N

    def derivatives(
        self, rotation: Array, position: Array, noise: TrackerNoise
    ) -> list[sp.csr_array]:
        """Change of the rows per component of ξ, by central differences of one σ.

        A step as wide as the errors smooths the corners of the interpolation, as the
        errors themselves do.
        """
        changes = []
        for unit in np.eye(6):
            ahead = self.at(*noise.moved(rotation, position, unit))
            behind = self.at(*noise.moved(rotation, position, -unit))
            changes.append(sp.csr_array(0.5 * (ahead - behind)))
        return changes
