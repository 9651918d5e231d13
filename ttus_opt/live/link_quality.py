"""Round trip, clock offset, loss and rate of a link, from headers of packets alone.

With t₁ the time an own packet left, t₂ and t₃ the other clock's times of its arrival
and of the reply, t₄ its arrival here, the round trip is t₄ − t₁ − (t₃ − t₂). The
offset of the clocks follows from the packet with the shortest round trip of the last
`WINDOW`, and is right within half of it. Source: D. L. Mills, RFC 5905.
"""

from __future__ import annotations

import math
from collections import deque

#: Time over which quality is judged [s]
WINDOW = 5.0

#: Most packets and, with headers, most bytes a second that are sent [1/s]: 64 kbit/s;
#: most bytes at once, a longest datagram
PACKETS, BYTES, BUCKET = 50.0, 8000.0, 1500.0


class LinkQuality:
    """Statistics of the packets that arrive from one sender.

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
