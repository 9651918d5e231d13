"""Comparators that reduce a contact to a depth, a rate and a place.

The normal force acts along the patch's unit wrench (`contact_geometry.Patch`); a
subclass gives its magnitude for a depth h, a rate of approach ḣ and a place on the
surface. It never pulls.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.comparators.base import LEAST_FORCE, Comparator
from ttus_opt.comparators.contact_geometry import Patch, Touch
from ttus_opt.contact.standing import skin_points
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import Trajectory

#: Unit of depths, so that K in K h^n is the force at 10 mm for any n [m]
DEPTH_UNIT = 0.01

#: Frames with a smaller depth are not fitted to [m]
LEAST_DEPTH = 0.0005

#: Fewest frames in contact for a fit [–]
FEWEST_FRAMES = 5


@dataclass(frozen=True)
class Contact:
    """One contact.

    Attributes:
        depth: Depth of the deepest point, h [10 mm].
        rate: Rate of approach, ḣ [10 mm/s].
        place: Foot of the patch's centre on the surface, patient frame, (3,) [m].
        sliding: Velocity along the surface, shape (3,) [m/s].
        patch: The contact patch.
    """

    depth: float
    rate: float
    place: Array
    sliding: Array
    patch: Patch = field(repr=False)


@dataclass(frozen=True)
class Sample:
    """A contact with its measured force.

    Attributes:
        contact: The contact.
        normal_force: Along the patch's normal force [N].
        tangential_force: The rest of the force, shape (3,) [N].
    """

    contact: Contact
    normal_force: float
    tangential_force: Array = field(repr=False)


class PatchModel(Comparator):
    """A law of depth, rate and place."""

    def contact(self, touch: Touch, at: Array, twist: Array) -> Contact:
        """Depth, rate and place of a touch of at least one point."""
        patch = touch.patch
        velocity = patch.velocity(twist, touch.reference, at)
        approach = -float(velocity @ patch.direction)
        x, y, z = patch.centre
        return Contact(
            patch.depth / DEPTH_UNIT,
            approach / DEPTH_UNIT,
            skin_points(self.surface, np.arctan2(y, x), z),
            velocity + approach * patch.direction,
            patch,
        )

    def samples(self, recording: Trajectory, force: Array) -> list[Sample]:
        """Frames in contact whose force pushes, in order.

        Raises:
            InputError: Fewer than `FEWEST_FRAMES` of them.
        """
        found, touching, twist = [], 0, recording.twist()
        for t, at in enumerate(recording.position):
            touch = self.geometry.touch(recording.rotation[t], at)
            if not len(touch) or touch.patch.depth < LEAST_DEPTH:
                continue
            touching += 1
            contact = self.contact(touch, at, twist[t])
            direction = contact.patch.direction
            normal = float(force[t] @ direction)
            if normal > LEAST_FORCE:
                rest = force[t] - normal * direction
                found.append(Sample(contact, normal, rest))
        if len(found) < FEWEST_FRAMES:
            raise InputError(
                f"{self.name} needs {FEWEST_FRAMES} frames with contact and a pushing "
                f"force, got {len(found)} of {touching} in contact: record more "
                "contact, and give the force ON the probe in patient axes"
            )
        return found

    def _fit(self, recording: Trajectory, force: Array) -> None:
        self._fit_law(self.samples(recording, force))

    def _wrench(self, R: Array, at: Array, twist: Array) -> tuple[Array, int]:
        touch = self.geometry.touch(R, at)
        if not len(touch):
            return np.zeros(6), 0
        contact = self.contact(touch, at, twist)
        size = max(self._normal_force(contact), 0.0)
        return size * contact.patch.unit + self._drag(contact, size), len(touch)

    def _drag(self, contact: Contact, normal_force: float) -> Array:
        """Wrench of friction, none by default, shape (6,) [N, N·m]."""
        return np.zeros(6)

    @abstractmethod
    def _fit_law(self, samples: list[Sample]) -> None:
        """Fit the law's parameters."""

    @abstractmethod
    def _normal_force(self, contact: Contact) -> float:
        """Magnitude of the normal force [N]; negative values count as zero."""
