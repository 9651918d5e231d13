"""Loops in real time around the state machines: one for each side.

A loop runs at a rate by absolute times, so that lateness does not add up, and says how
late it was. It ends after some seconds, when asked, or never.
"""

from __future__ import annotations

import contextlib
import math
import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import TtusWarning
from ttus_opt.live.follower import Follower
from ttus_opt.live.messages import Sample
from ttus_opt.live.operator import LiveState, Operator
from ttus_opt.live.patient import Patient
from ttus_opt.live.peer import Outgoing, Peer
from ttus_opt.live.safety import State

#: Frames a second of the operator's loop, beside the haptic one, and of the follower's
#: [Hz]
OPERATOR_RATE, FOLLOWER_RATE = 200.0, 100.0

#: Real-time priorities: of the haptic loop, and of the loops beside it
HAPTIC, BESIDE = 50, 30

#: Time between what a page is shown [s]
SHOW = 0.1

#: Lateness from which a frame is late, over its period [–]
LATE = 1.0

#: Lateness from which the frames that were missed are not made up for [s]
MISSED = 0.1

#: Longest retraction at the end of the follower's loop: 8 cm at 5 cm/s, and more [s]
RETRACTION = 2.0

#: Time before a deadline that is waited for busily, as sleep is coarser [s]
SPIN = 2e-4


class Link(Protocol):
    """One side of a link."""

    @property
    def overhead(self) -> int:
        """What it adds to a packet, towards a session's rate [bytes]."""

    def send(self, now: float, packets: tuple[Outgoing, ...]) -> None:
        """Send packets."""

    def receive(self, now: float) -> list[bytes]:
        """What has arrived."""


class HandDevice(Protocol):
    """A haptic device: says where it is, and shows a wrench."""

    rotation: Array
    position: Array

    def step(self, time: float, wrench: Array, seconds: float) -> None:
        """Show a wrench for some seconds.

        Args:
            time: From the start [s].
            wrench: Force, then torque about the shell's reference, patient axes, shape
                (6,) [N, N·m]; a device of three axes takes the force alone.
            seconds: Until the next step [s].
        """


@runtime_checkable
class HapticLoop(Protocol):
    """A haptic loop that runs elsewhere."""

    @property
    def alive(self) -> bool:
        """Whether it runs."""

    @property
    def frames(self) -> int:
        """Frames so far [–]."""

    @property
    def pose(self) -> tuple[Array, Array]:
        """The hand's rotation (3, 3) and position (3,) [m]."""

    def new_frames(self) -> Array:
        """Its frames since the last call, (k, numbers of a frame)."""

    def tell(self, friction: float, state: State) -> None:
        """Publish a sign of life and the operator's state."""


@dataclass(frozen=True)
class Lateness:
    """How late the frames of a loop were.

    Attributes:
        frames: Number of frames [–].
        rate: Frames a second [Hz].
        median: Lateness [s].
        p99: 99 % of frames are at most this late [s].
        worst: Largest lateness [s].
        late: Share of frames later than one period [–].
    """

    frames: int
    rate: float
    median: float
    p99: float
    worst: float
    late: float

    @classmethod
    def of(cls, times: Sequence[float], period: float) -> Lateness:
        """Of a list of times [s], such as of packets sent once a period [s]."""
        found = np.asarray(times or [math.nan])
        median, p99, worst = np.quantile(found, [0.5, 0.99, 1.0]).tolist()
        late = float((found > LATE * period).mean())
        return cls(len(times), 1.0 / period, median, p99, worst, late)


class Metronome:
    """Absolute deadlines at a rate; after a pause of the process they begin anew.

    Args:
        rate: Frames a second [Hz].
        seconds: Length; ``math.inf`` for no end.
    """

    #: Lateness is counted in these steps up to a second [s]
    STEP = 1e-5

    def __init__(self, rate: float, seconds: float = math.inf) -> None:
        self._period, self._seconds = 1.0 / rate, seconds
        # a histogram: memory does not grow with time
        self._counts = np.zeros(100_001, dtype=np.int64)
        self._worst, self._start, self._frames = 0.0, 0.0, 0

    def __iter__(self) -> Iterator[float]:
        """Times of frames from `time.monotonic`, each when it is due."""
        self._start = begun = time.monotonic()
        while True:
            due = begun + self._frames * self._period
            if due - self._start >= self._seconds:
                return
            wait = due - time.monotonic()
            if wait > SPIN:
                time.sleep(wait - SPIN)
            while (now := time.monotonic()) < due:
                pass
            late = now - due
            self._worst = max(self._worst, late)
            self._counts[min(int(late / self.STEP), len(self._counts) - 1)] += 1
            self._frames += 1
            if late > MISSED:
                begun += late
            yield now

    @property
    def lateness(self) -> Lateness:
        """Of the frames so far."""
        n = max(self._frames, 1)
        shares = np.cumsum(self._counts) / n
        lasted = max(time.monotonic() - self._start, 1e-9)
        above = self._counts[int(LATE * self._period / self.STEP) :].sum()
        return Lateness(
            self._frames,
            self._frames / lasted,
            self.STEP * float(np.searchsorted(shares, 0.5)),
            self.STEP * float(np.searchsorted(shares, 0.99)),
            self._worst,
            float(above) / n,
        )


def promptly(priority: int = BESIDE) -> None:
    """Have this process scheduled by SCHED_FIFO, where the system grants it."""
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


@dataclass(frozen=True)
class Ended:
    """How a side's loop ended.

    Attributes:
        state: State of that side.
        cause: Why it is not NORMAL.
        lateness: Of its frames.
        seen: States it was in.
    """

    state: str
    cause: str
    lateness: Lateness
    seen: tuple[str, ...]


@dataclass(frozen=True)
class OperatorFrame:
    """One frame of the operator's loop, before its step.

    Attributes:
        time: That side's clock [s].
        pose: Of the hand, as the step is given it: (3, 3), (3,) [m].
        packets: What arrived.
        felt: Frames of the haptic loop since the last one; None before it runs.
        measured: The newest measurement; None before the first.
    """

    time: float
    pose: tuple[Array, Array]
    packets: Sequence[bytes]
    felt: Array | None
    measured: Sample | None


class _Seen:
    """States of a side, told when they change."""

    def __init__(self, peer: Peer, tell: Callable[[str, str], None] | None) -> None:
        self._safety, self._tell = peer.safety, tell or (lambda state, cause: None)
        self._last: State | None = None
        self._names: dict[str, None] = {}

    def look(self) -> None:
        """After a frame."""
        safety = self._safety
        if safety.state is not self._last:
            self._last = safety.state
            self._names[safety.state.name] = None
            self._tell(safety.state.name, safety.cause)

    def ended(self, beat: Metronome) -> Ended:
        """How the loop ended."""
        safety = self._safety
        return Ended(safety.state.name, safety.cause, beat.lateness, tuple(self._names))


def run_operator(
    operator: Operator,
    link: Link,
    start: tuple[Array, Array],
    *,
    seconds: float = math.inf,
    show: Callable[[LiveState], None] | None = None,
    record: Callable[[OperatorFrame], None] | None = None,
    tell: Callable[[str, str], None] | None = None,
) -> Ended:
    """The operator's loop: link and model; hand and force are in their own process.

    Args:
        operator: Its feedback is a `haptic_process.HapticProcess`, once a model came.
        link: To the follower.
        start: Pose of the hand until the haptic loop runs: (3, 3), (3,) [m].
        seconds: Length [s].
        show: Called ten times a second with what a page shows.
        record: Called with every frame, such as `Recorder.operated`.
        tell: Called with every new state, and why it is not NORMAL.
    """
    beat, seen = Metronome(OPERATOR_RATE, seconds), _Seen(operator.peer, tell)
    operator.peer.rate.overhead = link.overhead
    pose, shown = start, -math.inf
    for now in beat:
        loop = operator.feedback
        if isinstance(loop, HapticLoop):
            pose = loop.pose if loop.frames else start
            if not loop.alive:
                operator.stop("the haptic loop has died")
        packets = link.receive(now)
        if record is not None:
            felt = loop.new_frames() if isinstance(loop, HapticLoop) else None
            record(OperatorFrame(now, pose, packets, felt, operator.newest))
        step = operator.step(now, packets, *pose)
        link.send(now, step.send)
        if isinstance(loop, HapticLoop):
            model = operator.model
            friction = 0.0 if model is None else model.learner.friction
            loop.tell(friction, step.state)
            operator.feel(now, *pose)
        seen.look()
        if show is not None and now - shown >= SHOW:
            shown = now
            show(operator.view(now))
    return seen.ended(beat)


def run_follower(
    follower: Follower,
    link: Link,
    patient: Patient,
    rotation: Array,
    position: Array,
    *,
    seconds: float = math.inf,
    tell: Callable[[str, str], None] | None = None,
) -> Ended:
    """The follower's loop: link, probe, measurement.

    However it ends, the probe is retracted until nothing is felt, as in a STOP: for
    2 s at most, while the patient's side answers; a `TtusWarning` where it fails.

    Args:
        follower: The state machine.
        link: To the operator.
        patient: What the probe touches, by simulation, recording or a robot's driver.
        rotation: First target of the probe, (3, 3) [–].
        position: Its position, patient frame, (3,) [m].
        seconds: Length [s].
        tell: Called with every new state, and why it is not NORMAL.
    """
    beat, seen = Metronome(FOLLOWER_RATE, seconds), _Seen(follower.peer, tell)
    follower.peer.rate.overhead = link.overhead
    try:
        for now in beat:
            sensed = patient.sense(now, rotation, position)
            step = follower.step(now, link.receive(now), sensed)
            link.send(now, step.send)
            rotation, position = step.rotation, step.position
            seen.look()
        return seen.ended(beat)
    finally:  # by an interrupt too
        follower.stop("the follower's loop has ended")
        try:
            for now in Metronome(FOLLOWER_RATE, RETRACTION):
                sensed = patient.sense(now, rotation, position)
                step = follower.step(now, (), sensed)
                rotation, position = step.rotation, step.position
                if not follower.retracts:
                    break
        except Exception as error:  # whatever a driver that is gone raises
            warnings.warn(
                f"the probe was not retracted ({error}): lift it by hand",
                TtusWarning,
                stacklevel=2,
            )
