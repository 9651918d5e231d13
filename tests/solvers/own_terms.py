"""Terms over all voxels as a user writes them: ten lines each, without tags."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ttus_opt.terms.base import AffineRows, Term
from ttus_opt.terms.total_variation import difference_rows


@dataclass(frozen=True)
class DepthWeighted(Term):
    """Departures from the Laplace field, heavier with depth below the skin."""

    name = "depth_weighted"

    def rows(self) -> AffineRows:
        grid, scene = self.scene.voxmap.grid, self.scene
        theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
        skin = scene.voxmap.surface.radius_at(theta, z)
        depth = np.clip(skin - grid.r[:, None, None], 0.0, None) / 0.05
        rows = sp.csr_array(sp.diags_array(grid.flatten(depth)))
        return AffineRows({"p": rows}, rows @ scene.laplace.solve(scene.b))


@dataclass(frozen=True)
class AlongZ(Term):
    """Differences between slices."""

    name = "along_z"

    def rows(self) -> AffineRows:
        rows = difference_rows(self.scene.voxmap.grid)[2::3]
        rows = sp.csr_array(rows[np.diff(rows.indptr) > 0])
        return AffineRows({"p": rows}, np.zeros(rows.shape[0]))


@dataclass(frozen=True)
class SkinGraph(Term):
    """Differences between neighbouring spokes and slices just below the skin."""

    name = "skin_graph"

    def rows(self) -> AffineRows:
        grid = self.scene.voxmap.grid
        below = np.argmax(self.scene.voxmap.on_surface, axis=0) - 1
        index = np.arange(grid.n_voxels).reshape(grid.shape)
        voxels = np.take_along_axis(index, below[None], axis=0)[0]
        around = np.roll(voxels, -1, axis=0).ravel()
        one = np.concatenate([voxels.ravel(), voxels[:, :-1].ravel()])
        other = np.concatenate([around, voxels[:, 1:].ravel()])
        at = np.arange(len(one))
        entries = np.repeat([1.0, -1.0], len(at)), (np.tile(at, 2), np.r_[one, other])
        rows = sp.csr_array(entries, shape=(len(at), grid.n_voxels))
        return AffineRows({"p": rows}, np.zeros(len(at)))


@dataclass(frozen=True)
class Differences(Term):
    """Differences between neighbours in r, θ and z."""

    name = "differences"

    def rows(self) -> AffineRows:
        rows = difference_rows(self.scene.voxmap.grid)
        return AffineRows({"p": rows}, np.zeros(rows.shape[0]))


OWN = (DepthWeighted, AlongZ, SkinGraph)
