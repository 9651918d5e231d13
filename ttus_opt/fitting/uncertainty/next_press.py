"""Where to press next: the places that reduce the uncertainty of a region most.

The error of a fitted field is Gaussian (`uncertainty`). For a press at each of n nodes
of the skin let C be the covariance of the errors of the rendered normal forces, and
s_i² the variance of the noise of a press measured at node i. Measuring there leaves

    C − c_i c_iᵀ / (C_ii + s_i²),

c_i column i of C, whatever the force will be. The place with the largest sum of c_ji²
/ (C_ii + s_i²) over the nodes j of a region is taken, and the next one with what is
left.

Source: the greedy choice of sensors for a Gaussian process is that of A. Krause, A.
Singh, C. Guestrin, J. Mach. Learn. Res. 9 (2008) 235-284, with variances for entropies.
See docs/how-to/next-press.md.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.rows import diagonal_blocks
from ttus_opt.contact.standing import skin_frames, skin_points
from ttus_opt.core.arguments import expect_positive
from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.uncertainty.field_uncertainty import Uncertainty
from ttus_opt.fitting.uncertainty.skin_uncertainty import (
    SPACING,
    presses_at,
    skin_nodes,
    usual_depth,
)
from ttus_opt.fitting.uncertainty.wrench_uncertainty import (
    rendered,
    slopes_along,
    wrench_rows,
)
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.terms.depth_profile import voxel_depths
from ttus_opt.scan.cloud import inside
from ttus_opt.voxmap.grid import Sector, checked_sector, holds

#: Presses by default [–]
COUNT = 5

#: Least force of a press at which its place counts as reached [N]
LEAST_FORCE = 1e-6


@dataclass(frozen=True, eq=False)
class NextPresses:
    """Suggested presses, and the uncertainty of a press everywhere on the skin.

    Attributes:
        poses: A pose per suggested press, the best first; patient frame.
        node: Their nodes, shape (k,) [–].
        reduction: Share of the region's variance that each leaves less, (k,) [–].
        theta: Angles of all nodes, shape (n,) [rad].
        z: Heights of all nodes, shape (n,) [m].
        points: The skin below them, shape (n, 3) [m].
        normals: Outward normals, shape (n, 3) [–].
        force: Normal force of a press that the field renders, shape (n,) [N].
        before: Standard deviation of its error, shape (n,) [N].
        after: The same after all suggested presses, shape (n,) [N].
        in_region: Whether a node lies in the region asked for, shape (n,).
        depth: Depth of every press [m].
    """

    poses: Trajectory = field(repr=False)
    node: IntArray
    reduction: Array
    theta: Array = field(repr=False)
    z: Array = field(repr=False)
    points: Array = field(repr=False)
    normals: Array = field(repr=False)
    force: Array = field(repr=False)
    before: Array = field(repr=False)
    after: Array = field(repr=False)
    in_region: Mask = field(repr=False)
    depth: float

    @property
    def region_std(self) -> tuple[float, float]:
        """Root mean square of the deviations in the region, before and after [N]."""
        both = self.before[self.in_region], self.after[self.in_region]
        before, after = (float(np.sqrt(np.mean(std**2))) for std in both)
        return before, after

    def as_dict(self) -> dict[str, Any]:
        """The suggestions, for JSON."""
        before, after = self.region_std
        return {
            "depth_m": self.depth,
            "region_nodes": int(self.in_region.sum()),
            "region_std_before_N": before,
            "region_std_after_N": after,
            "presses": [
                {
                    "theta_deg": float(np.degrees(self.theta[i])),
                    "z_m": float(self.z[i]),
                    "point_m": self.points[i].tolist(),
                    "normal": self.normals[i].tolist(),
                    "position_m": self.poses.position[k].tolist(),
                    "quaternion_wxyz": self.poses.quat_wxyz[k].tolist(),
                    "expected_force_N": float(self.force[i]),
                    "variance_reduction": float(self.reduction[k]),
                    "std_before_N": float(self.before[i]),
                    "std_after_N": float(self.after[i]),
                }
                for k, i in enumerate(self.node.tolist())
            ],
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the poses as a trajectory CSV, one second each.

        Raises:
            FileError: The file cannot be written.
        """
        self.poses.save(path)


def next_press(
    uncertainty: Uncertainty,
    count: int = COUNT,
    *,
    sector: Sector | None = None,
    box: Sequence[float] | None = None,
    depth: float | None = None,
    spacing: float = SPACING,
) -> NextPresses:
    """The places to press next.

    Args:
        uncertainty: Uncertainty of the fitted field.
        count: Number of presses [–].
        sector: Angles of the region, from and to [rad]; None for all.
        box: xmin, xmax, ymin, ymax, zmin, zmax of the region's skin, patient frame [m];
            None for all.
        depth: Depth of a press [m]; None for the median of the recordings.
        spacing: Distance between nodes [m].

    Raises:
        InputError: No uncertainty, numbers that are not positive, a region without skin
            that was seen and lies in the grid, or presses deeper than draws are kept.
    """
    if not isinstance(uncertainty, Uncertainty):
        raise InputError(
            "next_press needs the Uncertainty of ttus_opt.uncertainty, got a "
            f"{type(uncertainty).__name__}"
        )
    scene = uncertainty.scene
    depth = usual_depth(scene) if depth is None else depth
    expect_positive(depth, "depth", "m")
    theta, z = (
        a.ravel()
        for a in np.meshgrid(*skin_nodes(scene.voxmap.surface, spacing), indexing="ij")
    )
    seen = scene.voxmap.surface.seen_at(theta, z)
    presses = presses_at(scene, theta[seen], z[seen], depth)
    rows, sized, noise = normal_forces(uncertainty, presses)
    force = rows @ uncertainty.potential.values.ravel()
    reached = np.abs(force) > LEAST_FORCE  # within the grid's sector
    at = np.flatnonzero(seen)[reached]
    if not len(at):
        raise InputError(
            "the field gives no force where the skin was seen: fit it to forces "
            "measured in contact"
        )
    if not 0 < count <= len(at):
        raise InputError(f"count must be 1 to {len(at)}, the places seen, got {count}")
    points = skin_points(scene.voxmap.surface, theta[at], z[at])
    region = _region(theta[at], points, sector, box)
    few = sp.csr_array(rows[reached]), len(at), sized[reached]
    covariance = uncertainty.covariance(*few)[0]
    if not np.isfinite(covariance).all():
        raise InputError(
            f"presses of {depth:g} m reach deeper than draws are kept: give "
            "uncertainty a larger depth"
        )
    chosen, reduction, after = greedy(covariance, noise[reached], region, count)
    poses = presses.select(np.flatnonzero(reached)[chosen])
    steps = np.arange(count)
    return NextPresses(
        replace(poses, time=steps.astype(np.float64), segment=steps * 0),
        chosen,
        reduction,
        theta[at],
        z[at],
        points,
        skin_frames(scene.voxmap.surface, theta[at], z[at])[:, :, 0],
        force[reached],
        np.sqrt(np.diag(covariance)),
        after,
        region,
        depth,
    )


def greedy(
    covariance: Array, noise: Array, region: Mask, count: int
) -> tuple[IntArray, Array, Array]:
    """Choose measurements one after the other by the variance that they explain.

    Args:
        covariance: C of the errors at n places, shape (n, n) [N²].
        noise: s², variance of a measurement at each of them, shape (n,) [N²].
        region: Places whose variance counts, shape (n,).
        count: How many are chosen.

    Returns:
        The chosen places, shape (count,); by what share of the region's variance each
        reduces it, (count,) [–]; standard deviations at all places afterwards, (n,)
        [N].
    """
    left = covariance.copy()
    whole = float(np.diag(left)[region].sum())
    chosen: list[int] = []
    shares: list[float] = []
    for _ in range(count):
        explained = (left[region] ** 2).sum(axis=0) / (np.diag(left) + noise)
        explained[chosen] = -1.0  # what a place has of its own, it has again
        best = int(explained.argmax())
        chosen.append(best)
        shares.append(float(explained[best]) / whole)
        column = left[:, best] / np.sqrt(left[best, best] + noise[best])
        left -= column[:, None] * column
    std = np.sqrt(np.maximum(np.diag(left), 0.0))
    return np.array(chosen), np.array(shares), std


def normal_forces(
    uncertainty: Uncertainty, presses: Trajectory
) -> tuple[sp.csr_array, Array, Array]:
    """Rows of the forces along the directions of contact, and the noise of measuring.

    Args:
        uncertainty: Uncertainty of the field.
        presses: A pose each, shape (k,).

    Returns:
        The rows, (k, V), the change of the forces per ln ℓ₀ of `contact-size`, (k,)
        [N], and the variances of their measurements' noise, (k,) [N²].
    """
    scene, k = uncertainty.scene, len(presses)
    potential = uncertainty.potential
    rows = wrench_rows(potential, scene.shell, presses)
    frame = np.arange(k)[:, None]
    forces = sp.csr_array(rows[(6 * frame + np.arange(3)).ravel()])
    u = (forces @ np.maximum(voxel_depths(scene.voxmap), 0.0)).reshape(k, 3)
    u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), np.finfo(float).tiny)
    noise = uncertainty.noise.covariance(rendered(potential, rows))[:, :3, :3]
    along = sp.csr_array(diagonal_blocks(u[:, None]) @ forces)
    sized = slopes_along(potential, scene.shell, presses) * (
        along @ potential.values.ravel()
    )
    return along, sized, np.einsum("ti,tij,tj->t", u, noise, u)


def _region(
    theta: Array, points: Array, sector: Sector | None, box: Sequence[float] | None
) -> Mask:
    """Nodes in the region asked for, shape (n,).

    Raises:
        InputError: An invalid sector or box, or a region without nodes.
    """
    out = np.ones(len(theta), dtype=bool)
    if box is not None:
        out &= inside(points, box)
    if sector is not None:
        checked = checked_sector(sector)
        assert checked is not None
        out &= holds(checked, theta)
    if not out.any():
        raise InputError(
            "no place of the region was seen by the scan and lies in the grid: give a "
            "larger region or a smaller spacing"
        )
    return out
