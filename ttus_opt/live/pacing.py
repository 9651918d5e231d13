"""When a packet may leave, so that no more than a window's bytes are on their way.

A packet bears its number and the newest one heard, which tells the round trip.
"""

from __future__ import annotations

import struct
from collections import deque

from ttus_opt.live.numbering import later

#: Number of a packet, and the newest one heard
HEADER = struct.Struct("<HH")
NUMBERS = 2**16

#: Most packets a second [1/s]: a session sends 50, and one more at a STOP; most bytes
#: on their way [bytes]: a loss narrows aiortc's window to 4640 at least, and it does
#: not grow while it is not full
MOST, WINDOW = 125.0, 4400

#: Most packets that wait for their echo: those of a second at 500 a second [–]
AWAY = 512


class Pacing:
    """Spreads one side's packets evenly over the round trip.

    Attributes:
        next: Before this time nothing may leave [s].
        round_trip: With the time that the other side waited [s]; 0 at first.
    """

    def __init__(self) -> None:
        self.next = self.round_trip = 0.0
        self._number = self._heard = 0
        self._away: deque[tuple[int, float]] = deque(maxlen=AWAY)  # number, since

    def wrap(self, now: float, data: bytes) -> bytes:
        """A packet that leaves now, with its header."""
        self._number = (self._number + 1) % NUMBERS
        self._away.append((self._number, now))
        packet = HEADER.pack(self._number, self._heard) + data
        share = len(packet) / WINDOW
        self.next = now + max(1.0 / MOST, share * self.round_trip)
        return packet

    def unwrap(self, now: float, packet: bytes) -> bytes:
        """What a packet holds that arrives now; empty for one without a header."""
        if len(packet) <= HEADER.size:
            return b""
        number, echo = HEADER.unpack_from(packet)
        if later(number, self._heard, NUMBERS) > 0:
            self._heard = number
        while self._away and later(echo, self._away[0][0], NUMBERS) >= 0:
            self.round_trip = now - self._away.popleft()[1]
        return packet[HEADER.size :]
