"""The follower's side: obeys poses, measures, and lets go when it should.

A pure state machine: packets, what the probe measures and a clock in; packets and a
target for the probe out. A robot's driver moves the probe to the target and calls
`Follower.step` with what it measured, at any rate; a person who holds the probe is
shown the target instead.
"""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.live.deadband import differ
from ttus_opt.live.messages import (
    MOST_SAMPLES,
    VERSION,
    Body,
    Hello,
    ModelMessage,
    PoseCommand,
    Sample,
    StateReport,
    SurfaceMessage,
    decoded_surface,
    measurement,
    pose_of,
)
from ttus_opt.live.peer import OPERATOR, Outgoing, Peer
from ttus_opt.live.safety import SafetyLimits, State, is_pose
from ttus_opt.probe.cylindrical import cylindrical
from ttus_opt.scan.surface import Surface

#: Time after which surface and model are sent again to who still says hello [s]
OFFER = 5.0


@dataclass(frozen=True)
class FollowerLimits:
    """What the follower lets the operator do.

    Attributes:
        speed: Fastest motion of the target [m/s].
        turn: Fastest turn of the target [rad/s].
        depth: Deepest position of the probe's origin below the skin [m].
        clearance: Largest distance from the skin [m].
        retreat: Speed of retraction [m/s].
        lifted: Force below which retraction ends [N].
        farthest: Longest retraction, where force says nothing [m].
        breath: Farthest that breathing moves the skin; beyond, STOP [m].
    """

    speed: float = 0.25
    turn: float = 2.0
    depth: float = 0.03
    clearance: float = 0.3
    retreat: float = 0.05
    lifted: float = 0.1
    farthest: float = 0.08
    breath: float = 0.05


@dataclass(frozen=True)
class FollowerStep:
    """What a step asks for.

    Attributes:
        send: Packets.
        rotation: Target of the probe, probe to patient, shape (3, 3) [–].
        position: Its position, patient frame, shape (3,) [m].
        state: State of this side.
        cause: Why it is not NORMAL.
    """

    send: tuple[Outgoing, ...]
    rotation: Array = field(repr=False)
    position: Array
    state: State
    cause: str


class Follower:
    """The patient's side of a session.

    Attributes:
        peer: Headers, safety and quality.
        surface: The patient's skin, for the workspace.
        retracts: Whether the last step moved the target outwards.
    """

    def __init__(
        self,
        epoch: int,
        surface: Surface,
        content: tuple[bytes, bytes],
        *,
        safety: SafetyLimits | None = None,
        limits: FollowerLimits | None = None,
    ) -> None:
        """A follower before the first packet.

        Args:
            epoch: Another at every start of this side, such as `time.time` in seconds.
            surface: The patient's skin.
            content: Messages of the surface and of the model over it, which every
                operator gets that joins.
            safety: When it holds and stops.
            limits: What it lets the operator do.
        """
        self.peer, self.surface = Peer(epoch % OPERATOR, safety), surface
        self.limits = limits or FollowerLimits()
        self._surfaces: tuple[bytes, ...] = content[:1]  # the last whole, its change
        self._model = content[1]
        self._greeted, self._offered, self._ready = 0, -np.inf, False
        self._command: tuple[Array, Array] | None = None
        self._commanded = -np.inf
        self._target: tuple[Array, Array] | None = None
        self._skin, self._obeys = np.zeros(3), False
        self._retracted, self.retracts = 0.0, False
        self._index = 0
        self._samples: deque[Sample] = deque(maxlen=MOST_SAMPLES)
        self._reported = -np.inf

    def step(
        self,
        now: float,
        packets: Sequence[bytes],
        sensed: Sample,
        skin: Array | None = None,
    ) -> FollowerStep:
        """Take what arrived and what was measured; say what to do.

        Where a camera or a belt tells how far breathing has moved the skin, the probe
        goes along: commands and samples are those of the patient at rest, which the
        operator feels, whatever the delay (`patient.SkinMotion`: images are late).

        Args:
            now: This side's clock, which never goes back [s].
            packets: Received bytes, in any order.
            sensed: Pose and wrench of the probe now.
            skin: Displacement of the skin now, patient frame, (3,) [m]; at rest when
                not given.

        Raises:
            InputError: The clock went back, or the first pose is not a number.
        """
        passed = min(self.peer.tick(now), 0.1)
        sensed = self._checked(sensed, skin, passed)
        send: list[Outgoing] = []
        for data in packets:
            self._take(now, data, send)
        safety, force = self.peer.safety, float(np.linalg.norm(sensed.wrench[:3]))
        torque = float(np.linalg.norm(sensed.wrench[3:]))
        usable = safety.check_wrench(force, torque)
        state = safety.judge(now, self._missing)
        obeyed, self._obeys = self._obeys, state is State.NORMAL
        if self._target is None or self._obeys is not obeyed:  # from where the probe is
            self._target = sensed.rotation.copy(), sensed.position.copy()
        if self._obeys:
            self._retracted, self.retracts = 0.0, False
            self._obey(passed)
        else:
            self._retract(passed, force)
        self.peer.announce(now, send)  # before what tells of a STOP without its cause
        self._report(now, sensed, usable, send)
        rotation, position = self._target
        position = position + self._skin
        return FollowerStep(tuple(send), rotation, position, state, safety.cause)

    def stop(self, cause: str = "the follower's button") -> None:
        """Stop now, by a button or a driver's fault; the other side follows."""
        self.peer.safety.stop(cause)

    def rearm(self, force: float) -> None:
        """End a STOP at zero contact, given the measured force [N]."""
        self.peer.safety.rearm(force)
        self._command = None

    def renew(self, now: float, surface: bytes, model: bytes) -> tuple[Outgoing, ...]:
        """Replace surface and model, and send the surface to the operator.

        Args:
            now: This side's clock [s].
            surface: The new surface's message, whole or as a change of the last whole.
            model: The whole model over it, for operators that join later.

        Raises:
            InputError: An unusable surface.
        """
        whole = self._surfaces[0]
        self.surface, is_whole = decoded_surface(surface, whole)
        self._surfaces = (surface,) if is_whole else (whole, surface)
        self._model = model
        return (self.peer.pack(now, SurfaceMessage(surface), reliable=True),)

    @property
    def _missing(self) -> str:
        """What this side still waits for."""
        if not self._ready:
            return "the operator has no model yet"
        return "" if self._command is not None else "no pose from the operator yet"

    def _take(self, now: float, data: bytes, send: list[Outgoing]) -> None:
        met = self.peer.met
        received = self.peer.receive(now, data)
        if self.peer.met != met:
            self._ready, self._command, self._commanded = False, None, -np.inf
        if received is None:
            return
        body, sent = received
        match body:
            case Hello(model=name) if name == zlib.crc32(self._model):
                self._ready = True
            case Hello() if self._greeted != self.peer.met or self._waits(now):
                self._greeted, self._offered = self.peer.met, now
                offer: list[Body] = [Hello(VERSION)]
                offer += map(SurfaceMessage, self._surfaces)
                offer.append(ModelMessage(self._model))
                send += [self.peer.pack(now, body, reliable=True) for body in offer]
            case PoseCommand() as command if sent >= self._commanded:
                self._commanded = sent
                self._command = pose_of(command)
            case _:
                pass

    def _waits(self, now: float) -> bool:
        """Whether what was sent to this operator seems to be lost with its stream."""
        return not self._ready and now - self._offered >= OFFER

    def _checked(self, sensed: Sample, skin: Array | None, passed: float) -> Sample:
        """The sample of the patient at rest; what is unusable stops this side."""
        skin = np.zeros(3) if skin is None else skin
        if float(np.linalg.norm(skin)) <= self.limits.breath:
            most = math.inf if self._target is None else self.limits.speed * passed
            self._skin = self._skin + _shortened(skin - self._skin, most)
        else:
            self.peer.safety.stop("the skin's motion is too large, or not a number")
        rotation, position = sensed.rotation, sensed.position - self._skin
        if not is_pose(rotation, position):
            if self._target is None:
                raise InputError("the probe's pose is not a pose: mend its tracker")
            self.peer.safety.stop("the probe's pose is not a pose")
            rotation, position = self._target
        return replace(sensed, rotation=rotation, position=position)

    def _obey(self, passed: float) -> None:
        """Move the target towards the command, within speeds and workspace."""
        assert self._command is not None and self._target is not None
        rotation, position = self._command
        before, most = self._target[1], self.limits.speed * passed
        way = _shortened(self._within(position) - before, most)
        # the straight way may lead through the patient
        way = _shortened(self._within(before + way) - before, most)
        turn = Rotation.from_matrix(rotation @ self._target[0].T).as_rotvec()
        angle, most = float(np.linalg.norm(turn)), self.limits.turn * passed
        if angle > most:
            part = Rotation.from_rotvec(turn * (most / angle)).as_matrix()
            rotation = part @ self._target[0]
        self._target = rotation, before + way

    def _within(self, position: Array) -> Array:
        """The nearest position along the spoke that is within the workspace."""
        r, theta, z = cylindrical(position[None])
        skin = float(self.surface.radius_at(theta, z)[0])
        limits = self.limits
        least, most = skin - limits.depth, skin + limits.clearance
        low, high = float(self.surface.z[0]), float(self.surface.z[-1])
        radius = min(max(float(r[0]), least), most)
        out = np.array([np.cos(theta[0]), np.sin(theta[0])])
        return np.array([*(radius * out), min(max(float(z[0]), low), high)])

    def _retract(self, passed: float, force: float) -> None:
        """Move the target outwards until the probe feels nothing."""
        assert self._target is not None
        limits = self.limits
        felt = not force <= limits.lifted  # also where it is not a number
        self.retracts = felt and self._retracted < limits.farthest
        if not self.retracts:
            return
        rotation, position = self._target
        _, theta, _ = cylindrical(position[None])
        step = limits.retreat * passed
        out = np.array([np.cos(theta[0]), np.sin(theta[0]), 0.0])
        self._retracted += step
        self._target = rotation, position + step * out

    def _report(
        self, now: float, sensed: Sample, usable: bool, send: list[Outgoing]
    ) -> None:
        """Send what differs noticeably, or a sign of life."""
        rate, safety = self.peer.rate, self.peer.safety
        if not rate.ready:
            return
        # what stopped this side teaches the operator nothing
        news = usable and (not self._samples or differ(sensed, self._samples[0]))
        if news and self.peer.met:
            self._samples.appendleft(sensed)
            self._index += 1
            count = 1
            while count < len(self._samples) and rate.fits(60 * (count + 2)):
                count += 1
            body = measurement(self._index, list(self._samples)[:count], now)
            send.append(self.peer.pack(now, body))
        elif now - self._reported < safety.limits.period:
            return
        else:
            send.append(self.peer.pack(now, StateReport()))
        self._reported = now


def _shortened(way: Array, most: float) -> Array:
    """A way (3,) of this length at most [m]."""
    length = float(np.linalg.norm(way))
    return way if length <= most else way * (most / length)
