"""A link made worse: delay, jitter, bursts of loss, duplicates, a limited rate.

Loss follows a chain of two states (E. N. Gilbert, Bell Syst. Tech. J. 39 (1960)
1253-1265; E. O. Elliott, 42 (1963) 1977-1997): all packets of a bad state are lost, and
it lasts for `burst` packets on average. The same seed gives the same link.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ttus_opt.core.errors import InputError
from ttus_opt.live.peer import Outgoing

if TYPE_CHECKING:
    from ttus_opt.live.real_time import Link

#: Time after which a stream sends again what was lost, beyond the delay there and back
#: [s]: the least of TCP
RESEND = 0.2

#: Longest delay in one direction, and longest jitter [s]
LONGEST_DELAY = 60.0


@dataclass(frozen=True)
class Impairment:
    """What a link in one direction does to packets.

    Attributes:
        delay: Time of every packet on its way [s].
        jitter: Largest further time, uniform [s].
        in_order: Whether a datagram waits for those sent before it.
        loss: Share of datagrams that are lost [–].
        burst: Mean length of a run of lost ones [–].
        duplicates: Share that arrives twice [–].
        rate: Most bits a second; what waits longer than a second is lost [bit/s].
        seed: Of the random numbers.
    """

    delay: float = 0.0
    jitter: float = 0.0
    in_order: bool = False
    loss: float = 0.0
    burst: float = 1.0
    duplicates: float = 0.0
    rate: float = math.inf
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what no link does."""
        for name in ("delay", "jitter"):
            if not 0.0 <= (value := getattr(self, name)) <= LONGEST_DELAY:
                raise InputError(
                    f"{name} must lie between 0 and {LONGEST_DELAY:g} s, got {value} s"
                )
        for name in ("loss", "duplicates"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise InputError(f"{name} is a share from 0 to below 1")
        if not (self.burst >= 1.0 and self.rate > 0.0):
            raise InputError("burst is at least one packet, and rate is positive")


class ImpairedLink:
    """One direction of a link, stepped by a clock.

    Attributes:
        now: How it is; may be replaced at any time, as by a slider.
        lost: Datagrams lost so far [–].
    """

    def __init__(self, impairment: Impairment | None = None) -> None:
        self.now = impairment or Impairment()
        self._rng = np.random.default_rng(self.now.seed)
        self._queue: list[tuple[float, int, Outgoing]] = []
        self._number = itertools.count()
        self._bad = False
        self._free = self._last = self._stream = -math.inf
        self.lost = 0

    def send(self, now: float, packets: Sequence[Outgoing]) -> None:
        """Put packets on their way."""
        for packet in packets:
            self._send(now, packet)

    def receive(self, now: float) -> list[bytes]:
        """What has arrived by now, in the order of arrival."""
        return [packet.data for packet in self.due(now)]

    def due(self, now: float) -> list[Outgoing]:
        """Packets that have arrived by now, to be passed on through another link."""
        arrived = []
        while self._queue and self._queue[0][0] <= now:
            arrived.append(heapq.heappop(self._queue)[2])
        return arrived

    @property
    def waits(self) -> bool:
        """Whether a packet is on its way."""
        return bool(self._queue)

    def _send(self, now: float, packet: Outgoing) -> None:
        given, rng = self.now, self._rng
        sending = 8.0 * len(packet.data) / given.rate
        start = max(now, self._free)
        is_lost = self._loses()
        if not packet.reliable and (is_lost or start - now > 1.0):
            self.lost += 1
            return
        self._free = start + sending
        arrival = self._free + given.delay + given.jitter * rng.random()
        if packet.reliable:
            while is_lost:
                arrival += 2.0 * given.delay + RESEND
                is_lost = self._loses()
            arrival = self._stream = max(arrival, self._stream)
        elif given.in_order:
            arrival = self._last = max(arrival, self._last)
        heapq.heappush(self._queue, (arrival, next(self._number), packet))
        if not packet.reliable and rng.random() < given.duplicates:
            again = arrival + given.jitter * rng.random()
            heapq.heappush(self._queue, (again, next(self._number), packet))

    def _loses(self) -> bool:
        """Whether the next packet is lost."""
        given = self.now
        if given.loss == 0.0:
            return False
        # stationary share of the bad state: loss; mean length of its runs: burst, or
        # longer where so much is lost that no run is short
        leave = min(1.0 / given.burst, (1.0 - given.loss) / given.loss)
        enter = leave * given.loss / (1.0 - given.loss)
        chance = 1.0 - leave if self._bad else enter
        self._bad = bool(self._rng.random() < chance)
        return self._bad


class WorseLink:
    """Any link through which one side sends worse.

    Where both sides use one, both directions are worse, each by its own `Impairment`.
    Packets leave when their side next sends, so that its period is added to the delay.

    Attributes:
        link: The link itself.
        way: What is on its way to it; its impairment may be replaced at any time.
    """

    def __init__(self, link: Link, impairment: Impairment) -> None:
        self.link, self.way = link, ImpairedLink(impairment)

    @property
    def overhead(self) -> int:
        """Of the link."""
        return self.link.overhead

    def send(self, now: float, packets: tuple[Outgoing, ...]) -> None:
        """Put packets on their way, and pass on those that are due."""
        self.way.send(now, packets)
        self.link.send(now, tuple(self.way.due(now)))

    def receive(self, now: float) -> list[bytes]:
        """What has arrived."""
        return self.link.receive(now)
