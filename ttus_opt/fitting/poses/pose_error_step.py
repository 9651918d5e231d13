"""A step of estimating errors of tracked poses: the model at the latest estimate.

With D the force rows at the latest poses, J their change with the poses times the
latest field, and y = f − J ξ₀ the forces seen from there, the model is linear,

    y = D p − J ξ + e,   p ~ N(φ, C),   ξ ~ N(K b, K),   e ~ N(0, Σ).

b is minus the gradient of ½ log det(Σ + D C Dᵀ), by which the integral over all fields
differs from the best one. Rows, f and J are those of the forces along the direction of
contact: across it, errors of the model are ten times as large
(`problem.terms.part_noise`), and would be taken for errors of the poses. Signs: J is
the change when a pose moves by +ξ; the errors ξ have moved the reported poses, so that
taking them off moves by −ξ.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from ttus_opt.contact.rows import PoseRows, diagonal_blocks
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.gaussian.conditioned import ByCovariance
from ttus_opt.gaussian.matern import SeparableCovariance
from ttus_opt.probe.tracker_noise import TrackerNoise
from ttus_opt.problem.terms.depth_map import DepthMapTerm
from ttus_opt.problem.terms.depth_map_estimate import (
    LEAST_FORCE,
    DepthMapEstimate,
    estimate_depth_map,
    neighbours,
)
from ttus_opt.problem.terms.drag_estimate import estimate_drag
from ttus_opt.problem.terms.part_noise import contact_directions

#: Relative standard deviation of the whole profile φ [–]
PROFILE_SPREAD = 0.5

#: Most frames that are used; others follow by correlation in time
MOST_FRAMES = 800

#: Frames whose standard deviations are found at once, which bounds the memory
AT_ONCE = 1000


#: Fewest places that are left out in turn
LEAST_PLACES = 3


class Check(NamedTuple):
    """Errors of normal forces at places left out, mean over the places.

    Attributes:
        places: Their number [–].
        refined: By the field that belongs to refined poses [N].
        reported: By the field of the poses as reported [N].
        difference_error: Standard error of their difference, over the places [N].
    """

    places: int
    refined: float
    reported: float
    difference_error: float

    @property
    def better(self) -> bool:
        """Whether refined poses predict enough places better, by a standard error."""
        gain = self.reported - self.refined
        return self.places >= LEAST_PLACES and gain > self.difference_error


class State(NamedTuple):
    """Estimates after a step.

    Attributes:
        xi: Errors of the poses over the tracker's noise, shape (T, 6) [–].
        std: Their standard deviations, shape (T, 6) [–].
        p: The field, shape (V,).
        depth_map: Hyperparameters of the field.
        prior: Of the field.
        given: The used forces less what the priors say, and their covariance [N].
    """

    xi: Array
    std: Array
    p: Array
    depth_map: DepthMapEstimate
    prior: FieldPrior
    given: ByCovariance


@dataclass(frozen=True)
class PoseErrorProblem:
    """Forces, poses and noise.

    Attributes:
        scene: Patient, probe and recordings; its sampling is used.
        noise: Of the tracker.
        rows: Force rows as functions of the poses.
        frames: Frames in contact that are used, shape (k,).
        place: Their places, shape (k,) [–].
        alike: Correlation of ξ in all frames with ξ in these, shape (T, k) [–].
        reported: Force rows at the poses as reported, shape (3T, V).
        normal: Products with the direction of contact u, shape (T, 3T) [–].
    """

    scene: Scene = field(repr=False)
    noise: TrackerNoise
    rows: PoseRows = field(repr=False)
    frames: IntArray = field(repr=False)
    place: IntArray = field(repr=False)
    alike: Array = field(repr=False)
    reported: sp.csr_array = field(repr=False)
    normal: sp.csr_array = field(repr=False)

    @classmethod
    def of(cls, scene: Scene, noise: TrackerNoise) -> Self:
        """The problem of a scene with measured forces, with drag where it is shown.

        Drag has a component along the contact. It is that of the poses as reported.
        """
        size = np.linalg.norm(scene.f.reshape(-1, 3), axis=1)
        frames = np.flatnonzero(scene.touching & (size > LEAST_FORCE))
        frames = frames[:: max(-(-len(frames) // MOST_FRAMES), 1)]
        place = scene.places[frames]
        alike = noise.correlations(scene.trajectory, frames)
        rows = PoseRows(scene.voxmap, scene.shell, scene.sampling)
        drag, reported = estimate_drag(scene), scene.N
        if drag.is_shown:
            rubbed = drag.friction_coefficient * drag.drag.rows.force
            reported = sp.csr_array(reported - rubbed)
        normal = diagonal_blocks(contact_directions(scene)[:, None])
        return cls(scene, noise, rows, frames, place, alike, reported, normal)

    def start(self) -> State:
        """The most likely field for exact poses.

        Raises:
            InputError: As of `estimate_depth_map`.
        """
        depth_map = estimate_depth_map(self.scene, self.reported, depth_error=0.0)
        none = np.zeros((len(self.alike), 6))
        prior = FieldPrior.of(self, depth_map, self.reported, [])
        misfit = (self.normal @ self.scene.f)[self.frames] - prior.rows @ prior.mean
        given = ByCovariance.of(prior.of_rows + prior.noise, misfit)
        p = prior.field(given.multipliers)
        return State(none, none, p, depth_map, prior, given)

    def step(self, last: State, *, estimate: bool) -> State:
        """The next estimate; ``estimate`` finds the field's hyperparameters again."""
        trajectory = self.scene.trajectory
        poses = self.noise.moved(trajectory.rotation, trajectory.position, -last.xi)
        rows, changes = self.rows.at(*poses), self.rows.derivatives(*poses, self.noise)
        rows = sp.csr_array(rows + (self.reported - self.scene.N))
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
        prior = FieldPrior.of(self, depth_map, rows, changes)
        expected = self.alike @ prior.shrinkage()
        seen = (self.normal @ slope.reshape(-1, 6))[self.frames]
        inner = prior.of_rows + prior.noise
        inner += (seen @ seen.T) * self.alike[self.frames]
        misfit = (self.normal @ force)[self.frames] - prior.rows @ prior.mean
        misfit += np.einsum("ti,ti->t", seen, expected[self.frames])
        given = ByCovariance.of(inner, misfit)
        xi = expected - self.alike @ (seen * given.multipliers[:, None])
        p = prior.field(given.multipliers)
        return State(xi, self._std(seen, given), p, depth_map, prior, given)

    def depth(self, xi: Array) -> Array:
        """By how much every frame is reported too deep, over the noise, (T,) [–]."""
        return -(self.normal @ xi[:, :3].ravel())

    def without_mean_depth(self, xi: Array) -> Array:
        """ξ less one depth of all frames, which the force law explains too, (T, 6)."""
        out = xi.copy()
        mean = self.depth(xi)[self.frames].mean()
        out[:, :3] += mean * self.normal.data.reshape(-1, 3)
        return out

    def check(self, refined: State, reported: State) -> Check:
        """Whether the field of refined poses predicts places left out better."""
        errors = self._left_out(refined), self._left_out(reported)
        _, place = np.unique(self.place, return_inverse=True)
        means = [np.bincount(place, each) / np.bincount(place) for each in errors]
        n, spread = len(means[0]), float((means[0] - means[1]).std())
        with_it, without = (float(each.mean()) for each in means)
        return Check(n, with_it, without, float(spread / np.sqrt(max(n - 1, 1))))

    def _left_out(self, state: State) -> Array:
        """Errors |e| by the field of all other places, at poses as reported, (k,) [N].

        Errors of the poses there are not known then, so that they cannot hide errors
        of the field. A place whose forces are what all others predict has no
        multipliers.
        """
        reported = sp.csr_array(self.normal @ self.reported)[self.frames]
        force = (self.normal @ self.scene.f)[self.frames]
        given, errors = state.given, np.empty(len(self.frames))
        news = given.left_out(self.place)
        for number in np.unique(self.place):
            there = self.place == number
            dual = given.solve(given.data - np.where(there, news, 0.0))
            dual[there] = 0.0  # exactly, not by rounding
            errors[there] = force[there] - reported[there] @ state.prior.field(dual)
        return np.abs(errors)

    def _pose_covariance(self, slope: Array, frames: IntArray) -> Array:
        """J K Jᵀ of some frames, shape (3k, 3k); slope (T, 3, 6) of all."""
        some = slope[frames]
        alike = self.noise.correlations(self.scene.trajectory, frames)[frames]
        flat = some.reshape(-1, 6)
        return np.asarray((flat @ flat.T) * np.kron(alike, np.ones((3, 3))))

    def _std(self, seen: Array, given: ByCovariance) -> Array:
        """Posterior standard deviations of ξ, shape (T, 6)."""
        left = np.empty((len(self.alike), 6))
        for first in range(0, len(left), AT_ONCE):
            some = slice(first, first + AT_ONCE)
            alike = self.alike[some].T
            for j in range(6):
                white = given.white(seen[:, j, None] * alike)  # J K of a component
                left[some, j] = 1.0 - np.einsum("ij,ij->j", white, white)
        return np.sqrt(np.maximum(left, 0.0))


@dataclass(frozen=True)
class FieldPrior:
    """The field's prior over the rows of the used frames.

    Attributes:
        rows: D, shape (m, V).
        changes: Change of these rows per component of ξ, over the touched voxels.
        mean: φ, shape (V,).
        varied: C, less the spread of the whole profile.
        columns: D C over the touched voxels, shape (m, n).
        of_rows: D C Dᵀ, shape (m, m).
        noise: Σ, with errors that frames of a press share, shape (m, m) [N²].
    """

    rows: sp.csr_array = field(repr=False)
    changes: list[sp.csr_array] = field(repr=False)
    mean: Array = field(repr=False)
    varied: SeparableCovariance = field(repr=False)
    columns: Array = field(repr=False)
    of_rows: Array = field(repr=False)
    noise: Array = field(repr=False)

    @classmethod
    def of(
        cls,
        problem: PoseErrorProblem,
        depth_map: DepthMapEstimate,
        rows: sp.csr_array,
        changes: list[sp.csr_array],
    ) -> Self:
        """The prior of a depth map; rows and changes of all frames."""
        scene, frames = problem.scene, problem.frames
        normal, *moved = ((problem.normal @ each)[frames] for each in (rows, *changes))
        model = DepthMapTerm.of(scene, depth_map)
        mean, varied = model.mean, model.covariance
        touched = np.unique(np.concatenate([m.indices for m in (normal, *moved)]))
        few = sp.csr_array(normal[:, touched])
        common = PROFILE_SPREAD * mean[touched]
        columns = few @ (varied.columns(touched).among + np.outer(common, common))
        return cls(
            normal,
            [sp.csr_array(each[:, touched]) for each in moved],
            mean,
            varied,
            columns,
            columns @ few.T,
            _noise(problem, depth_map, normal @ mean),
        )

    def shrinkage(self) -> Array:
        """b, by which errors that make the field's forces smaller are likelier, (k, 6).

        −½ d log det(Σ + D C Dᵀ)/dξ = the diagonal of (Σ + D C Dᵀ)⁻¹ D C ΔDᵀ, ΔD the
        rows' change when the pose moves by +ξ.
        """
        inner = self.of_rows + self.noise
        ahead = scipy.linalg.solve(inner, self.columns, assume_a="pos")
        each = [np.asarray(m.multiply(ahead).sum(axis=1)).ravel() for m in self.changes]
        return np.stack(each, axis=1)

    def field(self, dual: Array) -> Array:
        """φ + C Dᵀ y, shape (V,)."""
        loads, common = self.rows.T @ dual, PROFILE_SPREAD * self.mean
        varied = self.varied.times(loads) + (common @ loads) * common
        return np.asarray(self.mean + varied)


def _noise(problem: PoseErrorProblem, model: DepthMapEstimate, force: Array) -> Array:
    """Σ of the used frames, whose forces by the profile are (k,), shape (k, k) [N²]."""
    alike = neighbours(problem.scene, problem.frames)
    shared = model.shared_error**2 * alike * force[:, None] * force
    variance = model.sensor_noise**2 + (model.relative_noise * force) ** 2
    return np.asarray(shared + np.diag(variance))
