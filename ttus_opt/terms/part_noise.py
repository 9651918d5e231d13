"""Errors of measured wrenches, not alike in their parts: normal, tangential, torque.

A field's errors are model errors, mostly. Pressure that varies below the probe turns
the force of a field, while a real force follows the geometry of contact to less than a
degree; the direction of a force and its torque therefore say less about the field than
its size. With u the direction of contact of a frame and s the standard deviation of the
force along it, residuals e of forces and torques are divided by

    s (u uᵀ + κ (1 − u uᵀ))   and   κ s ℓ .

See docs/method.md, Noise by parts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.scene import Scene
from ttus_opt.terms.base import AffineRows
from ttus_opt.terms.depth_profile import voxel_depths
from ttus_opt.terms.structure import Whitened

#: κ, error of tangential force and of torque over ℓ, relative to that of the normal
#: force [–]: of 1, 3, 5, 10 and 30 the best on unseen places of simulated torsos; real
#: tissue is indifferent between 3 and 10
TANGENTIAL = 10.0


@dataclass(frozen=True)
class PartNoise:
    """Relative standard deviations of the parts of every measured wrench.

    Attributes:
        direction: u, direction of the force of a field that grows with depth, unit
            length; zero without contact; shape (T, 3) [–].
        size: s over its root mean square in contact, shape (T,) [–].
        level: That root mean square [N]; 1/level² is the likely weight of the rows.
        tangential: κ [–].
    """

    direction: Array = field(repr=False, compare=False)
    size: Array = field(repr=False, compare=False)
    level: float = 1.0
    tangential: float = TANGENTIAL

    @classmethod
    def of(cls, scene: Scene, size: Array | None = None) -> Self:
        """Directions from the geometry of a scene's contacts.

        Args:
            scene: Patient, probe and poses.
            size: s of every frame, shape (T,) [N]; None for 1 N.
        """
        T, touching = len(scene.trajectory), scene.rows.contact_points > 0
        size = np.ones(T) if size is None else np.asarray(size)
        level = float(np.sqrt(np.mean(size[touching] ** 2))) if touching.any() else 1.0
        return cls(contact_directions(scene), size / level, level)

    @property
    def force(self) -> Array:
        """Inverse standard deviations of the force, shape (T, 3, 3) [–]."""
        along = self.direction[:, :, None] * self.direction[:, None, :]
        mixed = along + (np.eye(3) - along) / self.tangential
        return np.asarray(mixed / self.size[:, None, None])

    @property
    def torque(self) -> Array:
        """The same of the torque over ℓ, shape (T, 3, 3) [–]."""
        return np.asarray(np.eye(3) / (self.tangential * self.size)[:, None, None])


def contact_directions(scene: Scene) -> Array:
    """Direction of the force of p = depth in every frame, (T, 3); zero without contact.

    It has no drag, and depends on the geometry alone.
    """
    force = scene.N @ np.maximum(voxel_depths(scene.voxmap), 0.0)
    force = force.reshape(-1, 3)
    length = np.linalg.norm(force, axis=1, keepdims=True)
    return np.asarray(force / np.where(length > 0.0, length, 1.0))


def whitened(
    by: Array, blocks: Mapping[str, sp.csr_array], measured: Array
) -> AffineRows:
    """Rows of measured wrenches, multiplied by a matrix for every frame.

    Args:
        by: The matrices, shape (T, 3, 3).
        blocks: Rows by variable, three per frame.
        measured: Shape (3T,).
    """
    T = len(by)
    columns = np.repeat(np.arange(3 * T).reshape(T, 1, 3), 3, axis=1)
    starts = 3 * np.arange(3 * T + 1)
    W = sp.csr_array((by.ravel(), columns.ravel(), starts), shape=(3 * T, 3 * T))
    rows = {name: sp.csr_array(W @ M) for name, M in blocks.items()}
    return AffineRows(rows, np.asarray(W @ measured), frozenset({Whitened(by)}))
