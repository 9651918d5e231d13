"""What the operator's hand feels: the model, or, for comparison, the delayed force.

`ModelFeedback` is what this package is for. `MeasuredForce` returns the last measured
force, as a bilateral teleoperator does; with a delay it is not stable. `PassiveForce`
adds time-domain passivity control: the energy that the hand got may not exceed what the
patient gave back, and a damper takes the excess. Source: J.-H. Ryu, J. Artigas, C.
Preusche, A passive bilateral control scheme for a teleoperator with time-varying
communication delay, Mechatronics 20 (2010) 812-823.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttus_opt.contact.friction import DRAG_AT_POINTS, FRICTION, PRESLIDING
from ttus_opt.core.arrays import Array
from ttus_opt.haptic.blend import BlendLaw, BlendState
from ttus_opt.haptic.depth_stop import DepthStop
from ttus_opt.haptic.frame import touch, wrench_of
from ttus_opt.haptic.surface_swap import PatientRenderer
from ttus_opt.live.messages import Sample
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.field import PotentialField

#: How a live model replaces the one before. Rate: a hand compares forces over about
#: 0.1 s, and notices 10 % (S. J. Lederman, R. L. Klatzky, Atten. Percept. Psychophys.
#: 71 (2009) 1439-1459; X. D. Pang, H. Z. Tan, N. I. Durlach, Percept. Psychophys. 49
#: (1991) 531-540), which at the 5 to 10 N of a press is 5 to 10 N/s; it is 0.008 N a
#: frame, less than the 0.02 to 0.04 N of motion alone. Reserve: 0.05 J is what a spring
#: of 1 N/mm stores at 10 mm; of every contact, so that an hour of examination does not
#: use it up
LIVE_BLEND = BlendLaw(force_rate=8.0, reserve=0.05, capacity=0.05, per_contact=True)

#: Travel over which a hand's friction builds up and turns round [m]. Coulomb drag along
#: an estimated velocity changes sides within some frames at every reversal, drives a
#: light hand to and fro, and gives it energy; skin shears for some millimetres instead.
#: At μ = 0.25 and 10 N, 50 mm/s change the force by 0.04 N a frame
PRESLIDING_LENGTH = 3e-3

#: Largest damping of the passivity controller [N·s/m]
MOST_DAMPING = 40.0


class Feedback:
    """Turns a hand's pose into the wrench that it feels; by itself into none."""

    def measured(self, sample: Sample) -> None:
        """A measurement arrived; by itself it reaches the hand through the model."""

    def update(self, field: PotentialField) -> None:
        """The model has learned; by itself it is not felt."""

    def felt(self, now: float, rotation: Array, position: Array) -> Array:
        """Force, then torque, shape (6,) [N, N·m]."""
        return np.zeros(6)


class ModelFeedback(Feedback):
    """The wrench of the model at the hand's pose, now."""

    def __init__(self, field: PotentialField, shell: PointShell) -> None:
        self.renderer = PatientRenderer(_held(field), shell, blend=LIVE_BLEND)
        reach = float(np.linalg.norm(shell.points - shell.reference, axis=1).max())
        self._reference = shell.reference
        self._stop = DepthStop(field.voxmap.grid.r_inner + reach)
        self.limited_by = ""

    @property
    def blend(self) -> BlendState:
        """State of the last update's swap."""
        return self.renderer.blend

    def at(self, rotation: Array, position: Array) -> Array:
        """Contact wrench of the present model at any pose, without drag, (6,)."""
        values, data = self.renderer.present()
        R, place = np.ascontiguousarray(rotation), np.ascontiguousarray(position)
        wrench = np.zeros(6)
        wrench_of(values, touch(R, place, data)[0], R, data, wrench)
        return wrench

    def update(self, field: PotentialField) -> None:
        """Blend another field in, over the same or another surface."""
        self.renderer.update(_held(field))

    def felt(self, now: float, rotation: Array, position: Array) -> Array:
        """Force, then torque, shape (6,) [N, N·m]."""
        lever = rotation @ self._reference
        place = self._stop(position + lever) - lever
        wrench = self.renderer.render(rotation, place, time=now)
        self.limited_by = wrench.limited_by
        return np.concatenate([wrench.force, wrench.torque])


def _held(field: PotentialField) -> PotentialField:
    """The field with presliding, where it has friction without."""
    own = field.parameters
    if not own.get(FRICTION, 0.0) or own.get(PRESLIDING, 0.0):
        return field
    held = {DRAG_AT_POINTS: 1.0, **own, PRESLIDING: PRESLIDING_LENGTH}
    return replace(field, parameters=held)


class MeasuredForce(Feedback):
    """The last measured wrench, whenever it was measured."""

    def __init__(self) -> None:
        self._last: Sample | None = None

    def measured(self, sample: Sample) -> None:
        """Keep the newest."""
        if self._last is None or sample.time > self._last.time:
            self._last = sample

    def felt(self, now: float, rotation: Array, position: Array) -> Array:
        """Force, then torque, shape (6,) [N, N·m]."""
        return np.zeros(6) if self._last is None else self._last.wrench.copy()


class PassiveForce(MeasuredForce):
    """The last measured force, less what would make the loop active."""

    def __init__(self) -> None:
        super().__init__()
        self._given = self._returned = 0.0  # to the hand, by the patient [J]
        self._before: tuple[float, Array] | None = None

    def measured(self, sample: Sample) -> None:
        """Enter the work that the patient did on the probe since the last sample."""
        last = self._last
        super().measured(sample)
        if last is not None and self._last is sample:
            mean = 0.5 * (last.wrench[:3] + sample.wrench[:3])
            self._returned += float(mean @ (sample.position - last.position))

    def felt(self, now: float, rotation: Array, position: Array) -> Array:
        """Force, then torque, shape (6,) [N, N·m]."""
        wrench, before = super().felt(now, rotation, position), self._before
        self._before = now, position.copy()
        if before is None or now <= before[0]:
            return wrench
        step = now - before[0]
        velocity = (position - before[1]) / step
        speed2 = float(velocity @ velocity)
        excess = self._given + float(wrench[:3] @ velocity) * step - self._returned
        if excess > 0.0 and speed2 > 1e-8:
            damping = min(excess / (step * speed2), MOST_DAMPING)
            wrench[:3] -= damping * velocity
        self._given += float(wrench[:3] @ velocity) * step
        return wrench
