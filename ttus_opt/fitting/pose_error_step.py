"""A step of estimating errors of tracked poses: the model at the latest estimate.

With D the force rows at the latest poses, J their change with the poses times the
latest field, and y = f − J ξ₀ the forces seen from there, the model is linear,

    y = D p − J ξ + e,   p ~ N(φ, C),   ξ ~ N(K b, K),   e ~ N(0, Σ).

b is minus the gradient of ½ log det(Σ + D C Dᵀ), by which the integral over all fields
differs from the best one. Signs: J is the change when a pose moves by +ξ; the errors ξ
have moved the reported poses, so that taking them off moves by −ξ.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from ttus_opt.arrays import Array, IntArray
from ttus_opt.contact.pose_rows import PoseRows
from ttus_opt.probe.tracker_noise import TrackerNoise
from ttus_opt.scene import Scene
from ttus_opt.terms.depth_map import voxel_profile
from ttus_opt.terms.depth_map_estimate import (
    LEAST_FORCE,
    DepthMapEstimate,
    estimate_depth_map,
)
from ttus_opt.terms.matern import SeparableCovariance

#: Relative standard deviation of the whole profile φ [–]
PROFILE_SPREAD = 0.5

#: Most frames that are used; others follow by correlation in time
MOST_FRAMES = 800

#: Frames whose standard deviations are found at once, which bounds the memory
AT_ONCE = 1000


class State(NamedTuple):
    """Estimates after a step.

    Attributes:
        xi: Errors of the poses over the tracker's noise, shape (T, 6) [–].
        std: Their standard deviations, shape (T, 6) [–].
        p: The field, shape (V,).
        depth_map: Hyperparameters of the field.
    """

    xi: Array
    std: Array
    p: Array
    depth_map: DepthMapEstimate


@dataclass(frozen=True)
class PoseErrorProblem:
    """Forces, poses and noise.

    Attributes:
        scene: Patient, probe and recordings; its sampling is used.
        noise: Of the tracker.
        rows: Force rows as functions of the poses.
        frames: Frames in contact that are used, shape (k,).
        alike: Correlation of ξ in all frames with ξ in these, shape (T, k) [–].
    """

    scene: Scene = field(repr=False)
    noise: TrackerNoise
    rows: PoseRows = field(repr=False)
    frames: IntArray = field(repr=False)
    alike: Array = field(repr=False)

    @classmethod
    def of(cls, scene: Scene, noise: TrackerNoise, friction: float) -> Self:
        """The problem of a scene with measured forces, and μ [–]."""
        at = scene.voxmap, scene.shell, scene.trajectory, scene.sampling
        size = np.linalg.norm(scene.f.reshape(-1, 3), axis=1)
        touching = scene.rows.contact_points > 0
        frames = np.flatnonzero(touching & (size > LEAST_FORCE))
        frames = frames[:: max(-(-len(frames) // MOST_FRAMES), 1)]
        alike = noise.correlations(scene.trajectory, frames)
        return cls(scene, noise, PoseRows.of(*at, friction), frames, alike)

    def start(self) -> State:
        """The most likely field for exact poses.

        Raises:
            InputError: As of `estimate_depth_map`.
        """
        own = self.scene.trajectory
        rows = self.rows.at(own.rotation, own.position)
        found = estimate_depth_map(self.scene, rows, depth_error=0.0)
        none = np.zeros((len(own), 6))
        prior = _Prior.of(self, found, rows, [])
        inner = prior.of_rows + np.diag(prior.noise)
        factor = scipy.linalg.cho_factor(inner, lower=True, overwrite_a=True)
        misfit = self.scene.f[prior.at] - prior.rows @ prior.mean
        p = prior.field(scipy.linalg.cho_solve(factor, misfit))
        return State(none, none, p, found)

    def step(self, last: State, *, estimate: bool) -> State:
        """The next estimate; ``estimate`` finds the field's hyperparameters again."""
        own = self.scene.trajectory
        poses = self.noise.moved(own.rotation, own.position, -last.xi)
        rows, changes = self.rows.at(*poses), self.rows.derivatives(*poses, self.noise)
        slope = np.stack([(each @ last.p).reshape(-1, 3) for each in changes], axis=2)
        force = self.scene.f - np.einsum("tij,tj->ti", slope, last.xi).ravel()
        depth_map = last.depth_map
        if estimate:
            depth_map = estimate_depth_map(
                self.scene,
                rows,
                force=force,
                errors=lambda frames: self._pose_covariance(slope, frames),
                depth_error=0.0,
            )
        prior = _Prior.of(self, depth_map, rows, changes)
        expected = self.alike @ prior.shrinkage()
        seen = slope[self.frames]
        inner = prior.of_rows + np.diag(prior.noise)
        inner += self._pose_covariance(slope, self.frames)
        factor = scipy.linalg.cholesky(inner, lower=True, overwrite_a=True)
        misfit = force[prior.at] - prior.rows @ prior.mean
        misfit += np.einsum("tij,tj->ti", seen, expected[self.frames]).ravel()
        dual = scipy.linalg.cho_solve((factor, True), misfit)
        back = np.einsum("tij,ti->tj", seen, dual.reshape(-1, 3))
        xi = expected - self.alike @ back
        return State(xi, self._std(seen, factor), prior.field(dual), depth_map)

    def _pose_covariance(self, slope: Array, frames: IntArray) -> Array:
        """J K Jᵀ of some frames, shape (3k, 3k); slope (T, 3, 6) of all."""
        own = slope[frames]
        alike = self.noise.correlations(self.scene.trajectory, frames)[frames]
        flat = own.reshape(-1, 6)
        return np.asarray((flat @ flat.T) * np.kron(alike, np.ones((3, 3))))

    def _std(self, seen: Array, factor: Array) -> Array:
        """Posterior standard deviations of ξ, shape (T, 6)."""
        left = np.empty((len(self.alike), 6))
        for first in range(0, len(left), AT_ONCE):
            some = slice(first, first + AT_ONCE)
            alike = np.repeat(self.alike[some].T, 3, axis=0)
            for j in range(6):
                both = seen[:, :, j].ravel()[:, None] * alike  # J K of a component
                white = scipy.linalg.solve_triangular(
                    factor, both, lower=True, overwrite_b=True
                )
                left[some, j] = 1.0 - np.einsum("ij,ij->j", white, white)
        return np.sqrt(np.maximum(left, 0.0))


@dataclass(frozen=True)
class _Prior:
    """The field's prior over the rows of the used frames.

    Attributes:
        at: Indices of the rows, shape (m,).
        rows: D, shape (m, V).
        changes: Change of these rows per component of ξ, over the touched voxels.
        mean: φ, shape (V,).
        covariance: C without the spread of the whole profile.
        columns: D C over the touched voxels, shape (m, n).
        of_rows: D C Dᵀ, shape (m, m).
        noise: Diagonal of Σ, shape (m,).
    """

    at: IntArray = field(repr=False)
    rows: sp.csr_array = field(repr=False)
    changes: list[sp.csr_array] = field(repr=False)
    mean: Array = field(repr=False)
    covariance: SeparableCovariance = field(repr=False)
    columns: Array = field(repr=False)
    of_rows: Array = field(repr=False)
    noise: Array = field(repr=False)

    @classmethod
    def of(
        cls,
        problem: PoseErrorProblem,
        found: DepthMapEstimate,
        rows: sp.csr_array,
        changes: list[sp.csr_array],
    ) -> Self:
        """The prior of a depth map; rows and changes of all frames."""
        scene, frames = problem.scene, problem.frames
        at = (3 * frames[:, None] + np.arange(3)).ravel()
        own, moved = rows[at], [each[at] for each in changes]
        mean = voxel_profile(scene, found.profile)
        covariance = SeparableCovariance.over(
            scene.voxmap,
            found.deviation * mean,
            found.surface_length,
            found.depth_length,
            found.length_ratio,
        )
        touched = np.unique(np.concatenate([m.indices for m in (own, *moved)]))
        few = sp.csr_array(own[:, touched])
        among = covariance.columns(touched).among
        among += PROFILE_SPREAD**2 * np.outer(mean[touched], mean[touched])
        columns = few @ among
        squares = (scene.f.reshape(-1, 3)[frames] ** 2).sum(axis=1)
        variance = found.sensor_noise**2 + found.relative_noise**2 * squares
        return cls(
            at,
            own,
            [sp.csr_array(each[:, touched]) for each in moved],
            mean,
            covariance,
            columns,
            columns @ few.T,
            np.repeat(variance, 3),
        )

    def shrinkage(self) -> Array:
        """b, by which errors that make the field's forces smaller are likelier, (k, 6).

        −½ d log det(Σ + D C Dᵀ)/dξ = the diagonal of (Σ + D C Dᵀ)⁻¹ D C ΔDᵀ, summed
        over each frame, ΔD the rows' change when the pose moves by +ξ.
        """
        inner = self.of_rows + np.diag(self.noise)
        ahead = scipy.linalg.solve(inner, self.columns, assume_a="pos")
        each = [np.asarray(m.multiply(ahead).sum(axis=1)) for m in self.changes]
        return np.stack([one.reshape(-1, 3).sum(axis=1) for one in each], axis=1)

    def field(self, dual: Array) -> Array:
        """φ + C Dᵀ y, shape (V,)."""
        back = self.rows.T @ dual
        whole = 1.0 + PROFILE_SPREAD**2 * float(self.mean @ back)
        return np.asarray(whole * self.mean + self.covariance.times(back))
