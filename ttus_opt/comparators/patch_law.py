"""A contact law with a few parameters per patch, estimated recursively.

A first recursion over all samples initialises every patch; each patch then continues
with its own samples. Rendering interpolates the parameters between patches.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Protocol, Self, Unpack

import numpy as np

from ttus_opt.comparators.base import Given
from ttus_opt.comparators.patch_model import Contact, PatchModel, Sample
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.scan.surface import Surface

#: Forgetting factor: after 400 frames the first has two thirds of its weight [–]
FORGETTING = 0.999


#: Patches around the patient, and their height [m]: both about 4 cm
AROUND, HEIGHT = 24, 0.04


class Estimator(Protocol):
    """A recursion that estimates a law's parameters."""

    def take(self, sample: Sample, weight: float) -> None:
        """Update with one weighted sample."""

    def as_prior(self) -> Self:
        """A copy to initialise a patch."""

    @property
    def parameters(self) -> Array:
        """The current parameters of the law."""


class PatchLaw(PatchModel):
    """Recursive estimates per contact patch.

    Attributes:
        forgetting: Factor of the recursions [–].
        patches: Grid of the patches.
        per_patch: Parameters, shape (patches, parameters).
    """

    def __init__(
        self, *, forgetting: float = FORGETTING, **given: Unpack[Given]
    ) -> None:
        super().__init__(**given)
        if not (math.isfinite(forgetting) and 0.0 < forgetting <= 1.0):
            raise InputError(f"forgetting must be in (0, 1], got {forgetting}")
        self.forgetting = forgetting
        self.patches = PatchGrid(self.surface)
        self.per_patch = np.zeros((self.patches.n_patches, 0))

    def _fit_law(self, samples: list[Sample]) -> None:
        whole = self._estimator()
        for sample in samples:
            whole.take(sample, 1.0)
        by_patch: dict[int, Estimator] = {}
        for sample in samples:
            for patch, share in self.patches.shares(sample.contact.place):
                by_patch.setdefault(patch, whole.as_prior()).take(sample, share)
        self.per_patch = np.tile(whole.parameters, (self.patches.n_patches, 1))
        for patch, estimator in by_patch.items():
            self.per_patch[patch] = estimator.parameters

    def _normal_force(self, contact: Contact) -> float:
        blend = sum(
            share * self.per_patch[patch]
            for patch, share in self.patches.shares(contact.place)
        )
        return self._law(np.asarray(blend), contact)

    @abstractmethod
    def _estimator(self) -> Estimator:
        """A recursion before its first sample."""

    @abstractmethod
    def _law(self, parameters: Array, contact: Contact) -> float:
        """The normal force [N]."""


class PatchGrid:
    """Nodes around and along the patient.

    A place belongs to the four nodes around it, bilinearly, so that parameters per
    patch are continuous over the surface.
    """

    def __init__(self, surface: Surface) -> None:
        self._low, length = float(surface.z[0]), float(np.ptp(surface.z))
        self._along = max(round(length / HEIGHT), 1) + 1
        self._per_metre = (self._along - 1) / length

    @property
    def n_patches(self) -> int:
        """Number of patches [–]."""
        return AROUND * self._along

    def shares(self, place: Array) -> list[tuple[int, float]]:
        """Nodes and weights, which add up to 1, of a place (3,), patient frame [m]."""
        u = np.arctan2(place[1], place[0]) / (2.0 * np.pi) * AROUND
        v = (place[2] - self._low) * self._per_metre
        v = float(min(max(v, 0.0), self._along - 1.0))
        j, k = int(np.floor(u)), min(int(v), self._along - 2)
        a, b = float(u - j), v - k
        corners = (
            (j, k, (1.0 - a) * (1.0 - b)),
            (j, k + 1, (1.0 - a) * b),
            (j + 1, k, a * (1.0 - b)),
            (j + 1, k + 1, a * b),
        )
        return [(j % AROUND * self._along + k, w) for j, k, w in corners if w > 0.0]
