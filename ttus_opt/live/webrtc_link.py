"""A session over WebRTC: poses and measurements on a data channel, the rest beside it.

Offer and answer go through the session's stream, which nobody without the key reads or
writes: it authenticates the fingerprints by which DTLS knows the other side. No other
server is asked, so both machines must reach each other. Surface and model stay on that
stream: on a channel of the same connection they would hold every pose back.

WebRTC's congestion control queues what it may not send yet, even what is unreliable,
and pauses where a loss narrows its window. So a packet is handed over once the one
before has left, at a pace that the window bears, if no newer one came meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import threading
import time
from collections import deque
from collections.abc import Coroutine, Sequence
from typing import Any

from ttus_opt.core.optional import load
from ttus_opt.live.impairment import ImpairedLink, Impairment
from ttus_opt.live.messages import LONGEST_DATAGRAM
from ttus_opt.live.pacing import HEADER, Pacing
from ttus_opt.live.peer import Outgoing
from ttus_opt.live.session_stream import SessionStream

#: Begin of an offer or answer on the stream; no packet begins like it
SIGNAL = b"webrtc "

#: Most packets that have arrived and were not fetched, and of the stream before the
#: channel opens [–]
ARRIVED, EARLY = 256, 16

#: Silence after which the operator offers anew: on the same stream, longer than a
#: connection takes over a round trip of a second; on a new one [s]
PATIENCE, SILENCE = 15.0, 1.0

#: Time between looks at what an impairment holds back [s]
LOOK = 5e-4

_log = logging.getLogger(__name__)


class WebRTCLink:
    """One side of a session over WebRTC.

    Attributes:
        port: TCP port of the follower's stream.
    """

    #: Headers of IPv4 and UDP, DTLS, SCTP and `pacing`; an acknowledgement, as aiortc
    #: sends one for every packet it receives; and its words about losses, at a round
    #: trip of 500 ms and 1 % [bytes]
    overhead = (28 + 37 + 28 + HEADER.size) + (28 + 37 + 28) + 47

    def __init__(
        self,
        key: bytes,
        host: str,
        port: int,
        *,
        calls: bool,
        impairment: Impairment | None = None,
    ) -> None:
        """Wait for the other side, or call it; see `session_stream.SessionStream`.

        A test may give an ``impairment``: what this side's datagrams suffer below
        WebRTC, which sees it as a network.
        """
        self._rtc = load("aiortc", "webrtc")
        self._calls, self._impairment = calls, impairment
        self._stream = SessionStream(key, host, port, calls=calls)
        self.port = self._stream.port
        self._signals: deque[bytes] = deque()
        self._arrived: deque[bytes] = deque(maxlen=ARRIVED)
        self._early: deque[bytes] = deque(maxlen=EARLY)
        self._pacing = Pacing()
        self._newest: bytes | None = None  # waits for the one before to leave
        self._timer: asyncio.TimerHandle | None = None
        self._offered, self._heard = 0, -math.inf
        self._connection: Any = None
        self._channel: Any = None
        # asyncio has its own thread, so that neither loop waits for the other; begun by
        # the first step, with the priority that the session's loop has by then
        self._runner = asyncio.Runner(loop_factory=asyncio.new_event_loop)
        self._loop, self._ended = self._runner.get_loop(), asyncio.Event()
        self._turn = asyncio.Lock()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def send(self, now: float, packets: Sequence[Outgoing]) -> None:
        """Send packets, and offers or answers."""
        stream = []
        for packet in packets:
            if packet.reliable:
                stream.append(packet.data)
            elif self._thread.is_alive():
                self._loop.call_soon_threadsafe(self._put, packet.data)
        while self._signals:
            stream.append(self._signals.popleft())
        self._stream.send(stream)

    def receive(self, now: float) -> list[bytes]:
        """What has arrived: nothing before the channel opens, lest silence follows."""
        for message in self._stream.receive(now):
            if message.startswith(SIGNAL):
                text = message[len(SIGNAL) :].decode(errors="replace")
                self._soon(self._answered(text) if self._calls else self._answer(text))
            else:
                self._early.append(message)
        arrived = []
        if self._is_open:
            while self._early:
                arrived.append(self._early.popleft())
        while self._arrived:
            arrived.append(self._arrived.popleft())
            self._heard = now
        if self._calls and self._stream.ready:
            is_new = self._stream.opened > self._offered
            if now - self._heard > (SILENCE if is_new else PATIENCE):
                self._offered, self._heard = self._stream.opened, now
                self._soon(self._offer())
        return arrived

    def close(self) -> None:
        """End the connection."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join()
        self._runner.close()
        self._stream.close()

    def _serve(self) -> None:
        """The thread: asyncio until `close`."""
        with self._runner:
            self._runner.run(self._until_ended())

    async def _until_ended(self) -> None:
        await self._ended.wait()
        await self._drop()

    def _soon(self, step: Coroutine[Any, Any, None]) -> None:
        if not self._thread.is_alive():
            self._thread.start()
        asyncio.run_coroutine_threadsafe(self._tried(step), self._loop)

    async def _tried(self, step: Coroutine[Any, Any, None]) -> None:
        """A step towards a connection; after one that fails silence brings another."""
        try:
            async with self._turn:
                await step
        except Exception as error:  # of aiortc: whatever it finds in the description
            _log.info("no connection by WebRTC: %s", error)

    async def _offer(self) -> None:
        connection = await self._begin()
        await connection.setLocalDescription(await connection.createOffer())
        self._tell(connection)

    async def _answer(self, text: str) -> None:
        connection = await self._begin()
        await connection.setRemoteDescription(self._described(text, "offer"))
        await connection.setLocalDescription(await connection.createAnswer())
        self._tell(connection)

    async def _answered(self, text: str) -> None:
        if self._connection is not None:
            described = self._described(text, "answer")
            await self._connection.setRemoteDescription(described)

    def _described(self, text: str, kind: str) -> Any:
        return self._rtc.RTCSessionDescription(sdp=text, type=kind)

    def _tell(self, connection: Any) -> None:
        self._signals.append(SIGNAL + connection.localDescription.sdp.encode())

    async def _begin(self) -> Any:
        """A new connection in place of the one before, with its channel."""
        await self._drop()
        self._pacing = Pacing()
        configuration = self._rtc.RTCConfiguration(iceServers=[])
        self._connection = self._rtc.RTCPeerConnection(configuration)
        self._channel = self._connection.createDataChannel(
            "packets", ordered=False, maxRetransmits=0, negotiated=True, id=0
        )
        self._channel.on("message", self._take)
        self._channel.on("bufferedamountlow", self._pass_on)
        if self._impairment is not None:
            self._worsen(self._connection.sctp.transport.transport, self._impairment)
        return self._connection

    async def _drop(self) -> None:
        connection, self._connection, self._channel = self._connection, None, None
        self._newest = None
        if connection is not None:
            await connection.close()

    def _take(self, data: object) -> None:
        """A message; text and what is too long are not of ours."""
        if not isinstance(data, bytes) or len(data) > HEADER.size + LONGEST_DATAGRAM:
            return
        if packet := self._pacing.unwrap(time.monotonic(), data):
            self._arrived.append(packet)

    def _put(self, data: bytes) -> None:
        """Take a packet, in place of one that still waits."""
        self._newest = data
        self._pass_on()

    def _pass_on(self) -> None:
        """Hand the newest packet over, once the one before has left and it is time."""
        data, now = self._newest, time.monotonic()
        if data is None or not self._is_open or self._channel.bufferedAmount:
            return
        if now < self._pacing.next:
            if self._timer is not None:
                self._timer.cancel()
            self._timer = self._loop.call_later(self._pacing.next - now, self._pass_on)
            return
        self._newest = None
        self._channel.send(self._pacing.wrap(now, data))

    @property
    def _is_open(self) -> bool:
        channel = self._channel
        return channel is not None and channel.readyState == "open"

    def _worsen(self, transport: Any, impairment: Impairment) -> None:
        """Impair the way of a connection's datagrams, at aiortc's inner seam."""
        way, forward = ImpairedLink(impairment), transport._send
        looking: set[asyncio.Task[None]] = set()

        async def send(data: bytes) -> None:
            way.send(time.monotonic(), [Outgoing(data)])
            if not looking:
                looking.add(task := asyncio.create_task(pass_on()))
                task.add_done_callback(looking.discard)

        async def pass_on() -> None:
            with contextlib.suppress(ConnectionError):  # closed meanwhile
                while way.waits:
                    await asyncio.sleep(LOOK)
                    for packet in way.due(time.monotonic()):
                        await forward(packet.data)

        transport._send = send
