"""NORMAL, HOLD, STOP: when a session may act, and when it must let go.

    NORMAL  packets arrive; the operator feels the model, the follower obeys
    HOLD    no packet for the longer of three periods and 100 ms, or not yet met, or the
            other side has stopped: the operator keeps the local model, with a warning;
            the follower retracts to zero force. Packets end it
    STOP    no packet for 500 ms, NaN, a flood of damaged packets, a limit, the button:
            no force on the hand, the follower retracts and obeys nothing. It latches:
            it ends only when someone re-arms this side, at zero contact

A side that hears of the other's STOP stops as well. Re-arming one side leaves it in
HOLD until the other is re-armed, too.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from ttus_opt.core.arguments import expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError


class State(enum.IntEnum):
    """State of one side."""

    NORMAL = 0
    HOLD = 1
    STOP = 2


@dataclass(frozen=True)
class SafetyLimits:
    """Limits of one side.

    Attributes:
        period: Longest time between packets that the other side intends [s].
        hold_seconds: HOLD after this, or three periods if that is longer [s].
        stop_seconds: STOP after this [s].
        damaged: Damaged packets within a second that are a flood [–].
        force: Largest measured force [N]; beyond, STOP.
        torque: Largest measured torque [N·m].
        contact: Force below which there is no contact, for re-arming [N].
    """

    period: float = 1.0 / 30.0
    hold_seconds: float = 0.1
    stop_seconds: float = 0.5
    damaged: int = 20
    force: float = 40.0
    torque: float = 4.0
    contact: float = 0.2

    def __post_init__(self) -> None:
        """Refuse limits that are not positive, or a STOP before a HOLD."""
        for name in self.__dataclass_fields__:
            expect_positive(getattr(self, name), name)
        if self.stop_seconds <= self.silence:
            raise InputError(
                f"stop_seconds must be longer than {self.silence:g} s, after which "
                f"a side holds, got {self.stop_seconds}"
            )

    @property
    def silence(self) -> float:
        """Time without a packet after which a side holds [s]."""
        return max(self.hold_seconds, 3.0 * self.period)


def is_pose(rotation: Array, position: Array) -> bool:
    """Whether a rotation (3, 3) turns, and it and a position (3,) are finite.

    A tracker that has lost its tool may send zeros, a mirror a determinant of −1.
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    volume = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return abs(volume - 1.0) <= 0.01 and math.isfinite(sum(position.tolist()))


class Supervisor:
    """The state of one side; a pure state machine.

    Attributes:
        state: Present state.
        cause: Why it is not NORMAL; empty in NORMAL.
        stops: Number of stops that began on this side so far [–].
        other: State of the other side, as it last told.
    """

    def __init__(self, limits: SafetyLimits | None = None) -> None:
        self.limits = limits or SafetyLimits()
        self.state, self.cause, self.stops = State.HOLD, "not met yet", 0
        self._heard = math.nan
        self._damaged: list[float] = []
        # stops of the other side: the last reported, and those accepted by re-arming
        self._reported = 0
        self._accepted: int | None = None
        self.other = State.HOLD

    def heard(self, now: float, other: State, stops: int, cause: str = "") -> None:
        """A packet arrived from the other side, with its state, its stops, and why."""
        self._heard, self.other, self._reported = now, other, stops
        if self._accepted is None:  # what was before we met does not stop this side
            self._accepted = stops
        if stops > self._accepted and self.state is not State.STOP:
            told = f": {cause}" if cause else ""
            self.state, self.cause = State.STOP, f"the other side stopped{told}"

    def forget_other(self) -> None:
        """Another process has taken the other side's place."""
        self._reported, self._accepted = 0, None

    def damaged(self, now: float) -> None:
        """A packet with a wrong checksum arrived."""
        self._damaged = [t for t in self._damaged if now - t < 1.0] + [now]
        if len(self._damaged) >= self.limits.damaged:
            self.stop("a flood of damaged packets")

    def stop(self, cause: str) -> None:
        """Stop now; the first cause stays."""
        if self.state is not State.STOP:
            self.state, self.cause = State.STOP, cause
            self.stops += 1

    def judge(self, now: float, ready: str = "") -> State:
        """The state at a time.

        Args:
            now: Time [s].
            ready: What is still missing, such as a model; empty when nothing is.
        """
        if self.state is State.STOP:
            return self.state
        silence = now - self._heard
        if silence >= self.limits.stop_seconds:
            self.stop(f"no packet for {1e3 * self.limits.stop_seconds:.0f} ms")
            return self.state
        if math.isnan(silence):
            cause = "not met yet"
        elif silence >= self.limits.silence:
            cause = f"no packet for {1e3 * self.limits.silence:.0f} ms"
        elif self.other is State.STOP:
            cause = "the other side has stopped"
        else:
            cause = ready
        self.state, self.cause = (State.HOLD if cause else State.NORMAL), cause
        return self.state

    def check_wrench(self, force: float, torque: float) -> bool:
        """Stop beyond the limits, or where a measurement is not a number [N], [N·m].

        Returns:
            Whether it is within them.
        """
        if not (math.isfinite(force) and math.isfinite(torque)):
            self.stop("a measurement is not a number")
        elif force > self.limits.force:
            self.stop(f"measured force above {self.limits.force:g} N")
        elif torque > self.limits.torque:
            self.stop(f"measured torque above {self.limits.torque:g} N m")
        else:
            return True
        return False

    def rearm(self, force: float) -> None:
        """End a STOP; to HOLD, from where packets lead to NORMAL.

        Args:
            force: Present force of contact [N].

        Raises:
            InputError: There is contact, or nothing to re-arm.
        """
        if self.state is not State.STOP:
            raise InputError("this side has not stopped: nothing to re-arm")
        if not force <= self.limits.contact:
            raise InputError(
                f"re-arm at zero contact only: the force is {force:.2f} N, lift the "
                "probe first"
            )
        self.state, self.cause = State.HOLD, "re-armed"
        self._heard = math.nan
        if self._accepted is not None:
            self._accepted = self._reported
        self._damaged = []


#: Time in which the force falls to zero at a STOP [s]
RELEASE = 0.05


class Gate:
    """Lets no force appear from nothing, and takes it away at a STOP.

    It opens when the model gives no force: before, the probe was not lifted since the
    model arrived or the side was re-armed. At a STOP the force falls to zero within
    `RELEASE`, from wherever it is.

    Attributes:
        gain: Share of the force that passes [–].
    """

    def __init__(self, contact: float) -> None:
        """A closed gate; below ``contact`` [N] there is no contact."""
        self._contact, self.gain = contact, 0.0
        self._before: float | None = None

    def __call__(self, now: float, wrench: Array, stopped: bool) -> Array:
        """What reaches the hand of a wrench, shape (6,) [N, N·m].

        Args:
            now: Time [s].
            wrench: Rendered, shape (6,).
            stopped: Whether the side is in STOP.
        """
        if stopped:
            passed = 0.0 if self._before is None else now - self._before
            self.gain, self._before = max(0.0, self.gain - passed / RELEASE), now
        else:
            is_open = self.gain == 1.0 and self._before is None
            lifted = wrench[:3] @ wrench[:3] < self._contact**2
            self.gain, self._before = (1.0 if is_open or lifted else 0.0), None
        return self.gain * wrench
