"""Errors of measured wrenches, not alike in their parts: normal, tangential, torque.

Three errors of a measured wrench matter to a field:

- the sensor's, and one in proportion to the force, alike in frames within 50 ms: each
  of n such frames counts as 1/n, so that a faster recording of the same motion does not
  outweigh the prior;
- a tracker's error of depth, which lasts about a second: with g the slope of the normal
  force in depth, it changes that force by g δ in all frames of that second alike;
- pressure that varies below the probe turns the force of a field, while a real force
  follows the geometry of contact to less than a degree. The direction of a force, and
  its torque, say less about the field than its size.

With u the direction of contact of a frame, normal residuals uᵀe have the covariance

    Σ_kl = n s_k² δ_kl + δ² g_k g_l exp(−|t_k − t_l|/1 s)

among the frames of a recording, and tangential ones and torques over ℓ the variance
n (s² + (0.2 m)²) with m the normal force. Normal residuals are made
independent frame by frame: of each, what a few earlier frames predict is subtracted
[A. V. Vecchia, J. R. Stat. Soc. B 50 (1988)].

See docs/method/formulations.md, Noise by parts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.rows import diagonal_blocks
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arguments import expect_not_negative
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.problem.terms.base import AffineRows
from ttus_opt.problem.terms.depth_profile import voxel_depths
from ttus_opt.problem.terms.structure import Whitened

#: Error of the direction of a force [rad]: of 0.05, 0.1, 0.2 and 0.3 the best on unseen
#: places of six simulated torsos and six recordings of tissue
TURN = 0.2

#: Errors of a normal force where none are estimated [N], and over the force [–]: the
#: medians of a depth map's priors
SENSOR, RELATIVE = 0.05, 0.03

#: Time over which a tracker's error decays [s]
LASTING = 1.0

#: Time within which a frame's own errors are alike [s]: twenty frames a second, as of
#: the torsos by which `TURN` was chosen, tell all that more of them would
ALIKE = 0.05

#: Earlier frames of contact that predict a frame's error: the last ones, whose noise
#: averages out, and some before
EARLIER = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32])


@dataclass(frozen=True, eq=False)
class PartNoise:
    """Errors of the parts of every measured wrench, over their level.

    Attributes:
        normal: Makes normal residuals independent with variance 1, lower triangular,
            shape (T, T) [–].
        across: Standard deviation of tangential parts and torque over ℓ, (T,) [–].
        direction: u, direction of the force of a field that grows with depth, unit
            length; zero without contact; shape (T, 3) [–].
        level: Root mean square error of normal forces in contact [N]; 1/level² is the
            likely weight of the rows.
        lost: Force that the errors of reported depths take from every normal force on
            average, shape (T,) [N].
    """

    normal: sp.csr_array = field(repr=False, compare=False)
    across: Array = field(repr=False, compare=False)
    direction: Array = field(repr=False, compare=False)
    level: float = 1.0
    lost: Array | float = field(default=0.0, repr=False, compare=False)

    @classmethod
    def of_direction(cls, scene: Scene, turn: float | None) -> Self | None:
        """Errors of measured normal forces, and of their direction by a given angle.

        Args:
            scene: With measured forces.
            turn: Error of the direction [rad]; None for alike components.

        Raises:
            InputError: The angle is negative or not finite.
        """
        if turn is None:
            return None
        expect_not_negative(turn, "direction_error", "rad")
        force = np.maximum(
            diagonal_blocks(contact_directions(scene)[:, None]) @ scene.f, 0.0
        )
        own = np.hypot(SENSOR, RELATIVE * force)
        return cls.of(scene, own, force, np.zeros(len(force)), turn)

    @classmethod
    def of(
        cls, scene: Scene, own: Array, force: Array, drift: Array, turn: float = TURN
    ) -> Self:
        """Errors of a scene's normal forces.

        Args:
            scene: Patient, probe and poses.
            own: s, standard deviations of the independent errors, shape (T,) [N].
            force: m, normal forces, shape (T,) [N].
            drift: g δ, standard deviations of the lasting errors, shape (T,) [N].
            turn: Error of the direction [rad].
        """
        touching = scene.touching
        size = own[touching] ** 2 + drift[touching] ** 2
        level = float(np.sqrt(size.mean())) if touching.any() else 1.0
        alike = np.sqrt(_crowding(scene))
        normal = independent(scene, alike * own / level, drift / level)
        across = alike * np.hypot(own, turn * force) / level
        return cls(normal, across, contact_directions(scene), level)

    @property
    def force(self) -> sp.csr_array:
        """The matrix of independent residuals of forces, shape (3T, 3T) [–]."""
        u = self.direction
        along = diagonal_blocks(u[:, None])
        beside = (np.eye(3) - u[:, :, None] * u[:, None, :]) / self.across[
            :, None, None
        ]
        return sp.csr_array(along.T @ self.normal @ along + diagonal_blocks(beside))

    def expected(self, force: Array) -> Array:
        """Measured forces, (3T,), with what errors of depths take from them [N]."""
        return force + (np.reshape(self.lost, (-1, 1)) * self.direction).ravel()

    @property
    def torque(self) -> sp.csr_array:
        """The same of torques over ℓ."""
        return diagonal_blocks(np.eye(3) / self.across[:, None, None])


def contact_directions(scene: Scene) -> Array:
    """Direction of the force of p = depth in every frame, (T, 3); zero without contact.

    It has no drag, and depends on the geometry alone.
    """
    force = scene.N @ np.maximum(voxel_depths(scene.voxmap), 0.0)
    force = force.reshape(-1, 3)
    length = np.linalg.norm(force, axis=1, keepdims=True)
    return np.asarray(force / np.where(length > 0.0, length, 1.0))


def _crowding(scene: Scene) -> Array:
    """Frames of a recording within `ALIKE`, at least one, shape (T,) [–]."""
    trajectory = scene.trajectory
    out = np.ones(len(trajectory))
    for there in trajectory.parts:
        time = trajectory.time[there]
        steps = max(time[-1] - time[0], ALIKE) / ALIKE
        out[there] = max((len(time) - 1) / steps, 1.0)
    return out


def lasting(time: Array, other: Array) -> Array:
    """Correlation of a tracker's errors at two times [s]."""
    return np.asarray(np.exp(-np.abs(time - other) / LASTING))


def independent(scene: Scene, own: Array, drift: Array) -> sp.csr_array:
    """Rows that make normal residuals nearly independent with variance 1, (T, T).

    Args:
        scene: Poses with their times and recordings.
        own: Standard deviations of errors of single frames, shape (T,).
        drift: Those of errors that last, shape (T,).
    """
    frames = np.flatnonzero(scene.touching)
    time, recording = scene.trajectory.time, scene.trajectory.segment
    n, T = len(frames), len(time)
    before = np.arange(n)[:, None] - EARLIER
    at, these = frames[np.maximum(before, 0)], frames[:, None]
    known = (before >= 0) & (recording[at] == recording[these])

    def shared(a: IntArray, b: IntArray) -> Array:
        return drift[a] * drift[b] * lasting(time[a], time[b])

    among = shared(at[:, :, None], at[:, None, :]) * known[:, :, None] * known[:, None]
    k = np.arange(len(EARLIER))
    among[:, k, k] += np.where(known, own[at] ** 2, 1.0)
    cross = shared(at, these) * known
    weights = np.linalg.solve(among, cross[..., None])[..., 0]
    rest = own[frames] ** 2 + drift[frames] ** 2 - np.sum(weights * cross, axis=1)
    scale = np.ones(T)
    scale[frames] = 1.0 / np.sqrt(rest)
    used = known & (weights != 0.0)
    row = np.broadcast_to(these, at.shape)[used]
    data = np.concatenate([scale, -(weights * scale[these])[used]])
    place = (
        np.concatenate([np.arange(T), row]),
        np.concatenate([np.arange(T), at[used]]),
    )
    return sp.csr_array(sp.coo_array((data, place), shape=(T, T)))


def whitened(
    by: sp.csr_array, blocks: Mapping[str, sp.csr_array], measured: Array
) -> AffineRows:
    """Rows of measured wrenches, multiplied by a matrix.

    Args:
        by: The matrix, shape (3T, 3T).
        blocks: Rows by variable, three per frame.
        measured: Shape (3T,).
    """
    rows = {name: sp.csr_array(by @ M) for name, M in blocks.items()}
    return AffineRows(rows, np.asarray(by @ measured), frozenset({Whitened(by)}))
