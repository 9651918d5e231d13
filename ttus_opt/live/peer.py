"""One end of a session: headers, safety and quality, the same for both sides.

It turns received bytes into bodies and bodies into bytes. No socket, no clock of its
own: time is an argument, and what is to be sent is returned.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from ttus_opt.core.errors import InputError
from ttus_opt.live.messages import (
    LONGEST,
    LONGEST_TEXT,
    MOST_TICKS,
    TICKS,
    VERSION,
    Body,
    DamagedError,
    Hello,
    MessageError,
    NotFiniteError,
    Packet,
    Stop,
    decode,
    encode,
)
from ttus_opt.live.numbering import Once, later
from ttus_opt.live.safety import SafetyLimits, State, Supervisor

#: Time over which quality is judged [s]
WINDOW = 5.0

#: Most packets and, with headers, most bytes a second that are sent [1/s]: 64 kbit/s;
#: most bytes at once, a longest datagram
PACKETS, BYTES, BUCKET = 50.0, 8000.0, 1500.0


class LinkQuality:
    """Round trip, clock offset and loss, from headers of packets that arrive.

    With t₁ the time an own packet left, t₂ and t₃ the other clock's times of its
    arrival and of the reply, t₄ its arrival here, the round trip is t₄ − t₁ − (t₃ −
    t₂). The offset of the clocks follows from the packet with the shortest round trip
    of the last `WINDOW`, and is right within half of it. Source: D. L. Mills, RFC 5905.

    Attributes:
        round_trip: Of the last packet [s]; NaN before the first.
    """

    def __init__(self) -> None:
        self.round_trip = math.nan
        self._trips: deque[tuple[float, float, float]] = deque()  # time, trip, offset
        self._arrived: deque[tuple[float, int]] = deque()  # time, sequence

    def arrived(self, now: float, sequence: int) -> None:
        """A packet arrived."""
        self._arrived.append((now, sequence))
        while now - self._arrived[0][0] > WINDOW:
            self._arrived.popleft()

    def echoed(self, now: float, left: float, held: float, sent: float) -> None:
        """A packet arrived that replies to one of ours.

        Args:
            now: This side's clock [s].
            left: This side's clock when the packet that is replied to left [s].
            held: How long the other side had it [s].
            sent: The other side's clock when it replied [s].
        """
        trip = max(now - left - held, 0.0)
        self.round_trip = trip
        self._trips.append((now, trip, sent + 0.5 * trip - now))
        while now - self._trips[0][0] > WINDOW:
            self._trips.popleft()

    @property
    def offset(self) -> float:
        """The other side's clock minus this one [s]; NaN before the first reply."""
        if not self._trips:
            return math.nan
        return min(self._trips, key=lambda trip: trip[1])[2]

    @property
    def loss(self) -> float:
        """Share of the packets that did not arrive in the last `WINDOW` [–]."""
        if len(self._arrived) < 2:
            return 0.0
        numbers = {sequence for _, sequence in self._arrived}
        return 1.0 - len(numbers) / (max(numbers) - min(numbers) + 1)


class SendRate:
    """Most packets and bytes a second, as a token bucket.

    Attributes:
        sent_packets: Datagrams sent so far [–].
        sent_bytes: Their bytes, with headers.
        overhead: What the link adds to a packet; by default as over UDP [bytes].
    """

    def __init__(self) -> None:
        self.sent_packets = self.sent_bytes = 0
        self.overhead = 28 + 32
        self._number, self._room = 1.0, BUCKET
        self._last = -math.inf

    def tick(self, now: float) -> None:
        """Let time pass."""
        passed = max(0.0, now - self._last)
        # sums of milliseconds fall short of a period by rounding
        self._number = min(1.0, self._number + passed * PACKETS + 1e-9)
        self._room = min(BUCKET, self._room + passed * BYTES)
        self._last = now

    @property
    def ready(self) -> bool:
        """Whether a packet may leave now."""
        return self._number >= 1.0 and self._room > 0.0

    def fits(self, size: int) -> bool:
        """Whether a packet of so many bytes leaves room for another one."""
        return self._room >= size + self.overhead + 200

    def took(self, size: int) -> None:
        """A packet left."""
        self._number -= 1.0
        self._room -= size + self.overhead
        self.sent_packets += 1
        self.sent_bytes += size + self.overhead


#: Bit of an operator's epoch: the sides differ even if they start in the same second
OPERATOR = 2**31

#: Packets whose numbers are remembered, so that none counts twice
REMEMBERED = 1024


@dataclass(frozen=True)
class Outgoing:
    """Bytes to send.

    Attributes:
        data: A packet.
        reliable: Whether it goes through the stream, which loses nothing, or as a
            datagram.
    """

    data: bytes
    reliable: bool = False


class Peer:
    """This end of a session.

    Attributes:
        safety: State of this side.
        quality: Of what arrives.
        rate: Of what is sent as datagrams.
        refused: Packets refused so far [–].
        met: Epoch of the other side; 0 before its first packet.
        now: This side's clock [s]; NaN before the first step.
        begun: Its first time [s].
    """

    def __init__(self, epoch: int, limits: SafetyLimits | None = None) -> None:
        self.epoch = epoch
        self.safety = Supervisor(limits)
        self.quality, self.rate = LinkQuality(), SendRate()
        self.refused = self.met = 0
        self._sequence = 0
        self._heard = Once(REMEMBERED)
        self._left: set[int] = set()  # epochs of processes that were replaced
        self._sent: int | None = None  # of the newest heard
        self._echo, self._echo_at = 0, math.nan
        self._told = 0
        self.now = self.begun = math.nan

    def tick(self, now: float) -> float:
        """A step begins; time since the one before, 0 at first [s].

        Raises:
            InputError: The clock went back.
        """
        if math.isnan(self.begun):
            self.now = self.begun = now
        passed = now - self.now
        if not passed >= 0.0:
            raise InputError(f"the clock must not go back, got {now} s")
        self.now = now
        self.rate.tick(now)
        return passed

    def receive(self, now: float, data: bytes) -> tuple[Body, float] | None:
        """A body and when it was sent, by the sender's clock, which never goes back.

        None for a packet that is refused or was seen before.
        """
        try:
            packet = decode(data, LONGEST)
        except MessageError as error:
            self.refused += 1
            if isinstance(error, DamagedError):
                self.safety.damaged(now)
            elif isinstance(error, NotFiniteError):
                self.safety.stop(str(error))
            return None
        if not self._is_new(packet):
            return None
        # the 32 bits of its clock are full after twelve hours
        before = packet.sent if self._sent is None else self._sent
        sent = (before + later(packet.sent, before, MOST_TICKS)) / TICKS
        self._judge(now, packet, sent)
        if isinstance(packet.body, Hello) and not self._agrees(packet.body):
            return None
        return packet.body, sent

    def _agrees(self, hello: Hello) -> bool:
        """Whether the other side has the same version and units; else both stop."""
        other = "follower" if self.epoch >= OPERATOR else "operator"
        if hello.version != VERSION:
            self.safety.stop(
                f"the {other} has version {hello.version} of messages, this side "
                f"{VERSION}: update the older one"
            )
        elif hello.units != "SI":
            self.safety.stop(f"the {other} has units {hello.units}, this side SI")
        return hello.version == VERSION and hello.units == "SI"

    def _is_new(self, packet: Packet) -> bool:
        """Whether a packet was not seen before and is of the present other process."""
        if packet.epoch == self.epoch:
            return False  # an echo of our own
        if packet.epoch != self.met:
            if packet.epoch in self._left:
                return False  # of a process before
            self._left.add(self.met)
            self.met, self._sent = packet.epoch, None
            self._heard = Once(REMEMBERED)
            self.quality = LinkQuality()
            self.safety.forget_other()
        return self._heard.add(packet.sequence)

    def _judge(self, now: float, packet: Packet, sent: float) -> None:
        if packet.sequence == self._heard.newest:
            self._echo, self._echo_at = packet.sent, now
            self._sent = round(sent * TICKS)
            cause = packet.body.cause if isinstance(packet.body, Stop) else ""
            self.safety.heard(now, State(packet.state), packet.stops, cause)
        self.quality.arrived(now, packet.sequence)
        if packet.echo:
            away = (round(now * TICKS) - packet.echo) % MOST_TICKS / TICKS
            self.quality.echoed(now, now - away, packet.held / TICKS, sent)

    def pack(self, now: float, body: Body, *, reliable: bool = False) -> Outgoing:
        """A body as a packet of this side."""
        self._sequence += 1
        held = 0 if math.isnan(self._echo_at) else round((now - self._echo_at) * TICKS)
        packet = Packet(
            self.epoch,
            self._sequence,
            round(now * TICKS) % MOST_TICKS or 1,  # 0 is no echo
            self._echo,
            min(max(held, 0), MOST_TICKS - 1),
            int(self.safety.state),
            self.safety.stops,
            body,
        )
        data = encode(packet)
        if not reliable:
            self.rate.took(len(data))
        return Outgoing(data, reliable)

    def announce(self, now: float, send: list[Outgoing]) -> None:
        """Tell the other side of a new STOP at once, whatever the rate."""
        if self.safety.stops > self._told:
            self._told = self.safety.stops
            if self.safety.state is State.STOP:
                send.append(self.pack(now, Stop(self.safety.cause[:LONGEST_TEXT])))
