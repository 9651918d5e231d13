"""A whole session in virtual time: hand, operator, two links, follower, patient.

Everything is stepped by one clock, so that a session is the same every time and takes
as long as its computation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.live.follower import Follower
from ttus_opt.live.impairment import ImpairedLink, Impairment
from ttus_opt.live.messages import Sample
from ttus_opt.live.operator import Operator
from ttus_opt.live.patient import Patient
from ttus_opt.live.safety import State
from ttus_opt.live.subject import Hand

#: Steps of the operator's and the follower's loops [s]
HAPTIC, FOLLOW = 1e-3, 1e-2

#: Difference of the two clocks of a simulation [s]: nothing may depend on it
CLOCKS_APART = 1234.5


@dataclass(frozen=True)
class Moment:
    """One haptic frame of a session.

    Attributes:
        time: From the start [s].
        rotation: Of the probe in the hand, to patient, shape (3, 3) [–].
        position: Its origin, patient frame, shape (3,) [m].
        packets: What the operator's side received.
        felt: Force, then torque on the hand, shape (6,) [N, N·m].
        operator: State of the operator's side.
        follower: State of the follower's side.
        sensed: What the probe measures now.
    """

    time: float
    rotation: Array = field(repr=False)
    position: Array = field(repr=False)
    packets: tuple[bytes, ...] = field(repr=False)
    felt: Array = field(repr=False)
    operator: State
    follower: State
    sensed: Sample = field(repr=False)


class Simulation:
    """A session that is stepped frame by frame.

    Attributes:
        operator: The hand's side.
        follower: The patient's side.
        hand: The hand.
        patient: The patient.
        there: Link from the operator to the follower.
        back: Link from the follower to the operator.
        skin: Displacement of the skin (3,) [m] at a time of the follower's clock, as a
            camera tells it; None without one.
        sensed: What the probe measured last; None before the first frame.
        time: From the start [s].
    """

    def __init__(
        self,
        operator: Operator,
        follower: Follower,
        hand: Hand,
        patient: Patient,
        impairment: Impairment | None = None,
    ) -> None:
        self.operator, self.follower = operator, follower
        self.hand, self.patient = hand, patient
        self.there, self.back = _pair(impairment or Impairment())
        self.skin: Callable[[float], Array] | None = None
        self.time = 0.0
        self._frame = 0
        self.sensed: Sample | None = None
        self._target = hand.rotation.copy(), hand.position.copy()
        self._felt = np.zeros(6)

    def worsen(self, impairment: Impairment) -> None:
        """Change both links from now on, as by a slider."""
        for link, own in zip((self.there, self.back), _pair(impairment), strict=True):
            link.now = own.now

    def step(self) -> Moment:
        """One haptic frame."""
        now = self.time = self._frame * HAPTIC
        if self._frame % round(FOLLOW / HAPTIC) == 0 or self.sensed is None:
            self._follow(now)
        self._frame += 1
        hand, operator = self.hand, self.operator
        packets = tuple(self.back.receive(now))
        pose = hand.rotation, hand.position.copy()
        self.there.send(now, operator.step(now, packets, *pose).send)
        felt = operator.feel(now, *pose).copy()
        hand.step(now, felt, HAPTIC)
        assert self.sensed is not None
        states = operator.peer.safety.state, self.follower.peer.safety.state
        return Moment(now, *pose, packets, felt, *states, self.sensed)

    def run(self, seconds: float) -> Iterator[Moment]:
        """So many seconds of frames."""
        for _ in range(round(seconds / HAPTIC)):
            yield self.step()

    def _follow(self, now: float) -> None:
        clock = now + CLOCKS_APART
        sensed = self.patient.sense(clock, *self._target)
        skin = self.skin(clock) if self.skin else None
        step = self.follower.step(clock, self.there.receive(now), sensed, skin)
        self.back.send(now, step.send)
        self._target, self.sensed = (step.rotation, step.position), sensed


def _pair(impairment: Impairment) -> tuple[ImpairedLink, ImpairedLink]:
    """Two directions alike, with their own random numbers."""
    other = replace(impairment, seed=impairment.seed + 1)
    return ImpairedLink(impairment), ImpairedLink(other)
