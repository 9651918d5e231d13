"""Point-cloud model whose stiffness and friction are sent when perceptibly different.

The remote side estimates stiffness K and friction coefficient μ of the current contact,
with a short memory:

    f_n = K h,   |f_t| = μ f_n while sliding.

An estimate is sent with its place when it differs from the operator-side model there by
more than a just noticeable difference (Weber's law). That model renders f_n = K(s) h
and Coulomb drag; between places it weights updates by inverse distance (Shepard), so
that the force has no steps.

Source: X. Xu, B. Cizmeci, A. Al-Nuaimi, E. Steinbach, Point cloud-based model-mediated
teleoperation with dynamic and perception-based model updating, IEEE Trans. Instrum.
Meas. 63 (2014) 2558–2569. Its surface comes from the point cloud; here it is the
patient's, as for all. Thresholds: 10 % for stiffness, 20 % or 0.05 for friction.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Unpack

import numpy as np

from ttus_opt.comparators.base import Given
from ttus_opt.comparators.contact_geometry import wrench_of
from ttus_opt.comparators.patch_law import RecursiveLeastSquares
from ttus_opt.comparators.patch_model import Contact, PatchModel, Sample
from ttus_opt.core.arguments import expect_not_negative
from ttus_opt.core.arrays import Array

#: Just noticeable differences, relative, and absolute lower limit for friction [–]
STIFFNESS_JND, FRICTION_JND, LEAST_FRICTION_JND = 0.10, 0.20, 0.05

#: Forgetting factor: a memory of about ten frames [–]
FORGETTING = 0.9

#: Speed above which the probe slides; width of the rendered drag's transition [m/s]
SLIDING = 0.003

#: Smoothing length of the interpolation between places [m]
NEAR = 0.003

#: A larger step between frames means that the probe was lifted [m]
LIFTED = 0.01

#: Fewest samples of a contact before an estimate is sent [–]
SETTLED = 3.0


class Update(NamedTuple):
    """A model update.

    Attributes:
        place: Place of the estimate, patient frame, shape (3,) [m].
        stiffness: K [N per 10 mm].
        friction: μ [–].
    """

    place: Array
    stiffness: float
    friction: float


class PerceptualUpdates(PatchModel):
    """Stiffness and friction by place, sent when perceptibly different.

    Attributes:
        stiffness_jnd: Just noticeable difference of the stiffness [–].
        updates: Updates sent.
        samples_seen: Number of frames in contact [–].
    """

    name = "perceptual_updates"
    summary = "stiffness and friction sent when a hand could tell (Xu and others 2014)"

    def __init__(
        self, *, stiffness_jnd: float = STIFFNESS_JND, **given: Unpack[Given]
    ) -> None:
        super().__init__(**given)
        expect_not_negative(stiffness_jnd, "stiffness_jnd")
        self.stiffness_jnd = stiffness_jnd
        self.updates: list[Update] = []
        self.samples_seen = 0

    def parameters(self) -> dict[str, float]:
        """Number of updates, and their fraction of the frames in contact."""
        sent = float(len(self.updates))
        return {"updates sent": sent, "share": sent / max(self.samples_seen, 1)}

    def model_at(self, place: Array) -> tuple[float, float]:
        """K and μ of the operator's model at a place (3,) on the surface [m]."""
        square = ((self._places - place) ** 2).sum(axis=1)
        weights = 1.0 / (square + NEAR**2) ** 2
        stiffness, friction = weights @ self._values / weights.sum()
        return float(stiffness), float(friction)

    def _fit_law(self, samples: list[Sample]) -> None:
        self.updates, self.samples_seen = [], len(samples)
        stiffness, friction = _estimate(5.0, 50.0), _estimate(0.0, 1.0)
        before: Contact | None = None
        for sample in samples:
            contact = sample.contact
            if before is None or np.linalg.norm(contact.place - before.place) > LIFTED:
                # in a new contact the old estimate is only an initial guess
                stiffness.covariance[:] = 50.0**2
                stiffness.samples = 0.0
            before = contact
            stiffness.update(np.array([contact.depth]), sample.normal_force)
            self._take_friction(friction, sample)
            if stiffness.samples >= SETTLED:
                self._send(contact.place, stiffness, friction)
        if not self.updates:  # contacts of one or two frames only
            self._send(samples[-1].contact.place, stiffness, friction)

    @staticmethod
    def _take_friction(friction: RecursiveLeastSquares, sample: Sample) -> None:
        """Coulomb's law along the motion, while sliding."""
        speed = float(np.linalg.norm(sample.contact.sliding))
        if speed > SLIDING:
            drag = -float(sample.tangential_force @ sample.contact.sliding) / speed
            friction.update(np.array([sample.normal_force]), drag)

    def _send(
        self,
        place: Array,
        stiffness: RecursiveLeastSquares,
        friction: RecursiveLeastSquares,
    ) -> None:
        """Send the estimates if they differ noticeably from the operator's model."""
        new_stiffness = max(float(stiffness.estimate[0]), 0.0)
        mu = max(float(friction.estimate[0]), 0.0)
        if self.updates:
            known, known_mu = self.model_at(place)
            same = abs(new_stiffness - known) <= self.stiffness_jnd * known
            least = max(FRICTION_JND * known_mu, LEAST_FRICTION_JND)
            if same and abs(mu - known_mu) <= least:
                return
        self.updates.append(Update(np.array(place), new_stiffness, mu))
        self._places = np.array([update.place for update in self.updates])
        self._values = np.array([update[1:] for update in self.updates])

    def _normal_force(self, contact: Contact) -> float:
        return self.model_at(contact.place)[0] * contact.depth

    def _drag(self, contact: Contact, normal_force: float) -> Array:
        speed = math.hypot(float(np.linalg.norm(contact.sliding)), SLIDING)
        friction = self.model_at(contact.place)[1]
        drag = -friction * normal_force / speed * contact.sliding
        return wrench_of(drag[None], contact.patch.arm[None])


def _estimate(first: float, spread: float) -> RecursiveLeastSquares:
    return RecursiveLeastSquares.start(
        np.array([first]), np.array([spread]), FORGETTING
    )
