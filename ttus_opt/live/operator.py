"""The operator's side: sends the hand's pose, learns the patient, and lets it be felt.

A pure state machine. `Operator.step` takes packets, the hand's pose and a clock, and
gives packets; `Operator.feel` gives the wrench of the hand's pose, at haptic rate. The
model learns from every measurement that arrives, whenever and in whatever order, so
that what is felt depends on the link only through its age.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.live.deadband import moved
from ttus_opt.live.feedback import Feedback, ModelFeedback
from ttus_opt.live.messages import (
    MOST_SAMPLES,
    VERSION,
    Hello,
    Measurement,
    MessageError,
    ModelMessage,
    Sample,
    SurfaceMessage,
    decoded_surface,
    pose_command,
    samples_of,
)
from ttus_opt.live.model import LiveModel, decode_model
from ttus_opt.live.numbering import Once
from ttus_opt.live.peer import OPERATOR, REMEMBERED, Outgoing, Peer
from ttus_opt.live.safety import Gate, SafetyLimits, State, is_pose
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap


@dataclass(frozen=True)
class LiveState:
    """The operator's side at one moment, ready to be shown.

    Attributes:
        time: Operator's clock [s].
        state: NORMAL, HOLD or STOP.
        cause: Why it is not NORMAL; empty in NORMAL.
        round_trip: Of the link [s]; NaN before the first reply.
        loss: Share of packets lost in the last seconds [–].
        model_age: Time since the follower measured what changed the model last [s];
            infinite before.
        folded: Samples that the model has learned from [–].
        blended: Share of the last update that the hand feels already [–].
        position: Hand, patient frame [m].
        force: Felt force on the hand, patient axes [N].
        torque: Felt torque [N·m].
        force_std: Standard deviation of the model's force there [N]; NaN without one.
        measured: The last sample; None before the first.
        felt_there: Force that the hand's model gives at that sample's pose [N], to
            compare with the measured one whatever the delay; None before the first.
        packets_per_second: Datagrams sent, on average [1/s].
        bits_per_second: With headers, on average [bit/s].
        limited_by: Limit that acts on the felt wrench, empty for none.
    """

    time: float
    state: str
    cause: str
    round_trip: float
    loss: float
    model_age: float
    folded: int
    blended: float
    position: tuple[float, float, float]
    force: tuple[float, float, float]
    torque: tuple[float, float, float]
    force_std: float
    measured: Sample | None
    felt_there: tuple[float, float, float] | None
    packets_per_second: float
    bits_per_second: float
    limited_by: str

    def as_dict(self) -> dict[str, Any]:
        """For JSON, without rotations."""
        content = asdict(self)
        if self.measured is not None:
            del content["measured"]["rotation"]
        return content


#: Time between hellos until the follower obeys; between updates of what is felt, and
#: of its uncertainty [s]
GREET, UPDATE, UNCERTAIN = 0.2, 0.05, 0.5

#: Samples remembered by number: all that a packet may bring that is not refused [–]
WINDOW = REMEMBERED + MOST_SAMPLES


@dataclass(frozen=True)
class OperatorStep:
    """What a step asks for.

    Attributes:
        send: Packets.
        state: State of this side.
        cause: Why it is not NORMAL.
    """

    send: tuple[Outgoing, ...]
    state: State
    cause: str


class Operator:
    """The hand's side of a session.

    Attributes:
        peer: Headers, safety and quality.
        shell: The probe.
        model: What is known of the patient; None before it arrives.
        feedback: What the hand feels; None before the model.
        folded: Samples learned from so far [–].
        newest: The newest measurement; None before the first.
        learns: Whether the model learns; not so in a comparison with one that does not.
    """

    def __init__(
        self,
        epoch: int,
        shell: PointShell,
        *,
        safety: SafetyLimits | None = None,
        feedback: Callable[[LiveModel], Feedback] | None = None,
        learns: bool = True,
    ) -> None:
        """An operator before the first packet.

        Args:
            epoch: Another at every start of this side, such as `time.time` in seconds.
            shell: The probe, the same as the follower's.
            safety: When it holds and stops.
            feedback: Makes what the hand feels from the model; by default
                `ModelFeedback`.
            learns: Whether the model learns.
        """
        self.peer = Peer(epoch % OPERATOR + OPERATOR, safety)
        self.shell = shell
        self.learns = learns
        self.model: LiveModel | None = None
        self.feedback: Feedback | None = None
        self.folded = 0
        self._make = feedback
        self._surface: Surface | None = None
        self._whole: bytes | None = None
        self._named = 0
        self._greeted = self._updated = self._sent = -math.inf
        self._last_sent: tuple[Array, Array] | None = None
        self._counted = Once(WINDOW)
        self.newest: Sample | None = None
        self._unlearned: list[Sample] = []
        self._state = self.peer.safety.state
        self._pending = False
        self._changed_at = -math.inf
        self._gate = Gate(self.peer.safety.limits.contact)
        self._felt = np.zeros(6)
        self._hand = np.zeros(3)
        self._uncertainty: UncertaintyMap | None = None
        self._stated = -math.inf

    def step(
        self, now: float, packets: Sequence[bytes], rotation: Array, position: Array
    ) -> OperatorStep:
        """Take what arrived and where the hand is.

        Args:
            now: This side's clock, which never goes back [s].
            packets: Received bytes, in any order.
            rotation: Probe in the hand, to patient, shape (3, 3) [–].
            position: Its origin, patient frame, shape (3,) [m].
        """
        self.peer.tick(now)
        send: list[Outgoing] = []
        samples: list[Sample] = []
        for data in packets:
            self._take(now, data, samples)
        safety, before = self.peer.safety, self._state
        state = safety.judge(
            now, "" if self.feedback else "no model of the patient yet"
        )
        self._unlearned += sorted(samples, key=lambda sample: sample.time)
        if state is before or state is not State.STOP:  # let go first, learn later
            for sample in self._unlearned:
                self._learn(sample)
            self._unlearned = []
            self._refresh(now)
        usable = is_pose(rotation, position)
        if not usable:
            safety.stop("the hand's pose is not a pose")
        self.peer.announce(now, send)  # before what tells of a STOP without its cause
        if usable:
            self._report(now, rotation, position, send)
        self._state = safety.state
        return OperatorStep(tuple(send), safety.state, safety.cause)

    def feel(self, now: float, rotation: Array, position: Array) -> Array:
        """Wrench on the hand, shape (6,) [N, N·m].

        It is zero until the hand has once been out of contact since a model arrived or
        this side was re-armed, so that no force ever appears from nothing. At a STOP it
        falls to zero within 50 ms.

        Args:
            now: This side's clock [s].
            rotation: Probe in the hand, to patient, shape (3, 3) [–].
            position: Its origin, patient frame, shape (3,) [m].
        """
        self._hand = np.asarray(position, dtype=float)
        if self.feedback is None or not is_pose(rotation, position):
            self._felt = np.zeros(6)
            return self._felt
        wrench = self.feedback.felt(now, rotation, position)
        if not math.isfinite(float(wrench.sum())):
            self.peer.safety.stop("a rendered force is not a number")
            wrench = np.zeros(6)
        stopped = self.peer.safety.state is State.STOP
        self._felt = self._gate(now, wrench, stopped)
        return self._felt

    def stop(self, cause: str = "the operator's button") -> None:
        """Stop now; the other side follows."""
        self.peer.safety.stop(cause)

    def rearm(self, rotation: Array, position: Array) -> None:
        """End a STOP, at a pose where the model gives no force; see `Supervisor`."""
        force = 0.0
        if self.feedback is not None:
            wrench = self.feedback.felt(self.peer.now, rotation, position)
            force = float(np.linalg.norm(wrench[:3]))
        self.peer.safety.rearm(force)

    def view(self, now: float) -> LiveState:
        """The present moment, for a page or a report."""
        peer, sample, feedback = self.peer, self.newest, self.feedback
        there, blended, limited = None, 1.0, ""
        if isinstance(feedback, ModelFeedback):
            blended, limited = feedback.blend.progress, feedback.limited_by
            if sample is not None:
                there = _tuple(feedback.at(sample.rotation, sample.position)[:3])
        lasted = max(now - peer.begun, 1e-3)
        return LiveState(
            time=now,
            state=peer.safety.state.name,
            cause=peer.safety.cause,
            round_trip=peer.quality.round_trip,
            loss=peer.quality.loss,
            model_age=now + peer.quality.offset - self._changed_at,
            folded=self.folded,
            blended=blended,
            position=_tuple(self._hand),
            force=_tuple(self._felt[:3]),
            torque=_tuple(self._felt[3:]),
            force_std=self._std(now),
            measured=sample,
            felt_there=there,
            packets_per_second=peer.rate.sent_packets / lasted,
            bits_per_second=8.0 * peer.rate.sent_bytes / lasted,
            limited_by=limited,
        )

    def _std(self, now: float) -> float:
        """Standard deviation of the felt force by the model [N]."""
        if self.model is None:
            return math.nan
        if self._uncertainty is None or now - self._stated >= UNCERTAIN:
            self._uncertainty, self._stated = self.model.learner.uncertainty, now
        size = float(np.linalg.norm(self._felt[:3]))
        return size * self._uncertainty.at(*self._hand.tolist()) if size else 0.0

    def _take(self, now: float, data: bytes, samples: list[Sample]) -> None:
        """One packet."""
        met = self.peer.met
        received = self.peer.receive(now, data)
        if self.peer.met != met:  # another process: its samples count anew
            self._counted = Once(WINDOW)
        if received is None:
            return
        message, sent = received
        try:
            match message:
                case SurfaceMessage(content=content):
                    self._take_surface(content)
                case ModelMessage(content=content):
                    self._take_model(content)
                    self._named, self._greeted = zlib.crc32(content), -math.inf
                case Measurement() as body:
                    samples += [
                        sample
                        for back, sample in enumerate(samples_of(body, sent))
                        if self._counted.add(body.index - back)
                    ]
                case _:
                    pass
        except MessageError as error:
            self.peer.safety.stop(str(error))

    def _take_surface(self, content: bytes) -> None:
        """A whole surface, or a change of the last whole one."""
        try:
            surface, is_whole = decoded_surface(content, self._whole)
            self._whole = content if is_whole else self._whole
            self._surface = surface
            if self.model is not None:
                self.model = self.model.over(surface)
                self._pending = True
        except InputError as error:
            raise MessageError(f"an unusable surface: {error}") from error

    def _take_model(self, content: bytes) -> None:
        """A whole model over the last surface."""
        if self._surface is None:
            raise MessageError("a model came before its surface")
        self.model = decode_model(content, self._surface, self.shell)
        self._pending = False
        if self.feedback is not None:
            self.feedback.update(self.model.field)
        elif self._make is not None:
            self.feedback = self._make(self.model)
        else:
            self.feedback = ModelFeedback(self.model.field, self.shell)

    def _learn(self, sample: Sample) -> None:
        """Take a sample into the model and what is felt."""
        if self.newest is None or sample.time > self.newest.time:
            self.newest = sample
        if self.feedback is not None:
            self.feedback.measured(sample)
        if self.model is None or not self.learns:
            return
        self.folded += 1
        if self.model.fold(sample).contact_points:
            self._pending = True
            self._changed_at = max(self._changed_at, sample.time)

    def _refresh(self, now: float) -> None:
        """Let the hand feel what was learned."""
        if not self._pending or now - self._updated < UPDATE or self.model is None:
            return
        if self.feedback is not None:
            self.feedback.update(self.model.field)
        self._pending, self._updated = False, now

    def _report(
        self, now: float, rotation: Array, position: Array, send: list[Outgoing]
    ) -> None:
        """Send a hello until the follower knows this side's model, and the pose."""
        waits = self.peer.safety.other is not State.NORMAL
        if (waits or not self._named) and now - self._greeted >= GREET:
            self._greeted = now
            hello = Hello(VERSION, self._named)
            send.append(self.peer.pack(now, hello, reliable=True))
        last = self._last_sent
        if not self.peer.rate.ready:
            return
        due = now - self._sent >= self.peer.safety.limits.period
        if due or last is None or moved((rotation, position), last):
            self._sent, self._last_sent = now, (rotation.copy(), position.copy())
            send.append(self.peer.pack(now, pose_command(rotation, position)))


def _tuple(values: Array) -> tuple[float, float, float]:
    a, b, c = values.tolist()
    return a, b, c
