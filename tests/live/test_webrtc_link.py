"""WebRTC on this machine: real connections, and a network made worse below them."""

import multiprocessing
import random
import re
import socket
import sys
import time

import numpy as np
import pytest

from tests.kit import python
from tests.live.test_socket_link import survives_a_new_operator, until
from ttus_opt.core.errors import MissingPackageError
from ttus_opt.live.impairment import Impairment
from ttus_opt.live.messages import LONGEST_DATAGRAM
from ttus_opt.live.pacing import HEADER
from ttus_opt.live.peer import Outgoing, Peer
from ttus_opt.live.session_stream import SessionStream
from ttus_opt.live.webrtc_link import SIGNAL, WebRTCLink

KEY = bytes(range(32))


@pytest.fixture
def links():
    pytest.importorskip("aiortc", reason="needs the extra webrtc")
    made = []

    def make(key=KEY, **options):
        made.append(WebRTCLink(key, "127.0.0.1", **options))
        return made[-1]

    yield make
    for link in made:
        link.close()


def pair(links, **options):
    """Two sides, connected."""
    there = links(port=0, calls=False, **options)
    here = links(port=there.port, calls=True, **options)
    connect(here, there)
    return here, there


def connect(here, there):
    def both(got):
        here.send(time.monotonic(), [Outgoing(b"to")])
        there.send(time.monotonic(), [Outgoing(b"fro")])
        return b"fro" in got[0] and b"to" in got[1]

    until(both, here, there)


def test_datagrams_and_stream_arrive(links):
    here, there = pair(links)
    large = bytes(100_000)
    here.send(time.monotonic(), [Outgoing(large, reliable=True)])

    def sent(got):
        here.send(time.monotonic(), [Outgoing(b"pose")])
        return {large, b"pose"} <= {*got[1]}

    got = until(sent, here, there)
    assert not any(one.startswith(SIGNAL) for one in got[0] + got[1])


def test_nothing_outside_is_asked_for_an_address(links):
    here, there = pair(links)
    for side in (here, there):
        ice = side._connection.sctp.transport.transport.iceGatherer._connection
        assert ice.stun_server is None
        assert ice.turn_server is None
        description = side._connection.localDescription.sdp
        assert {*re.findall(r" typ (\w+)", description)} == {"host"}


def test_another_key_does_not_connect(links):
    there = links(port=0, calls=False)
    stranger = links(bytes(32), port=there.port, calls=True)
    for _ in range(200):
        now = time.monotonic()
        for side in (there, stranger):
            side.send(now, [Outgoing(b"x"), Outgoing(b"y", reliable=True)])
            assert side.receive(now) == []
        time.sleep(0.002)
    assert there._connection is stranger._connection is None
    connect(links(port=there.port, calls=True), there)


def test_who_stands_between_is_not_heard(links, monkeypatch):
    """Another certificate than the one that the stream vouched for."""
    there = links(port=0, calls=False)
    here = links(port=there.port, calls=True)
    found = here._described

    def other(text, kind):
        changed, count = re.subn(
            r"(?<=:sha-256 )\w\w",
            lambda first: "00" if first[0] != "00" else "01",
            text,
        )
        assert count
        return found(changed, kind)

    monkeypatch.setattr(here, "_described", other)

    def refused(got):
        here.send(time.monotonic(), [Outgoing(b"pose")])
        connection = here._connection
        return connection is not None and connection.connectionState == "failed"

    assert until(refused, here, there) == [[], []]


def test_what_is_no_packet_is_refused(links):
    here, there = pair(links)
    longest = HEADER.size + LONGEST_DATAGRAM
    rng, peer, sent = random.Random(0), Peer(1), [b"", "text", bytes(longest + 1)]
    sent += [rng.randbytes(rng.randrange(1, 200)) for _ in range(300)]
    described = there._connection.localDescription.sdp
    host, port = re.search(r" ([\d.]+) (\d+) typ host", described).groups()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for data in sent:  # from the other side, and from anybody
            here._loop.call_soon_threadsafe(here._channel.send, data)
            stranger.sendto(rng.randbytes(50), (host, int(port)))
            stranger.sendto(b"\x16\xfe\xfd" + rng.randbytes(50), (host, int(port)))
            time.sleep(0.001)
    inside = {data[HEADER.size :] for data in sent[3:]}
    last = bytes(LONGEST_DATAGRAM)

    def arrived(got):  # of what is not kept a busy machine may lose any
        here._loop.call_soon_threadsafe(here._channel.send, bytes(longest))
        return last in got[1]

    got = until(arrived, here, there)[1]
    assert {*got} - {b"to", last} <= inside - {b""}
    assert len(got) > 100  # of 256 at most that wait
    for data in got:
        assert peer.receive(0.0, data) is None
    assert peer.refused == len(got)
    connect(here, there)


def test_a_description_that_is_none_leaves_silence(links):
    there = links(port=0, calls=False)
    forger = SessionStream(KEY, "127.0.0.1", there.port, calls=True)
    forger.send([SIGNAL + b"v=0\r\nm=nonsense", SIGNAL + bytes([255]) * 50, b"model"])
    end = time.monotonic() + 60.0
    while not there._early:
        now = time.monotonic()
        assert now < end
        assert forger.receive(now) == there.receive(now) == []
        forger.send([])
        there.send(now, [])
    forger.close()
    connect(links(port=there.port, calls=True), there)


def test_the_stream_waits_for_the_channel(links):
    """A side that hears the other and then nothing for long stops."""
    way = Impairment(delay=0.05)
    there = links(port=0, calls=False, impairment=way)
    here = links(port=there.port, calls=True, impairment=way)

    def arrived(got):
        here.send(time.monotonic(), [Outgoing(b"hello", reliable=True)])
        assert there._is_open or not got[1]
        return b"hello" in got[1]

    until(arrived, here, there)


@pytest.mark.slow
def test_a_session_reaches_normal_and_survives_a_new_operator(links):
    survives_a_new_operator(links)


def operate(port):
    here = WebRTCLink(KEY, "127.0.0.1", port, calls=True)
    while True:
        here.send(time.monotonic(), [Outgoing(b"to")])
        here.receive(time.monotonic())
        time.sleep(0.01)


@pytest.mark.slow
def test_a_side_that_is_killed_falls_silent_and_another_takes_its_place(links):
    there = links(port=0, calls=False)
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=operate, args=(there.port,), daemon=True)
    process.start()
    until(lambda got: b"to" in got[0], there)
    process.kill()
    process.join()
    there.receive(time.monotonic())
    for _ in range(50):
        there.send(time.monotonic(), [Outgoing(b"fro")])
        time.sleep(0.002)
    assert there.receive(time.monotonic()) == []
    connect(links(port=there.port, calls=True), there)


@pytest.mark.slow
def test_a_follower_that_starts_again_is_called_again(links):
    here, there = pair(links)
    there.close()
    connect(here, links(port=there.port, calls=False))


EXIT = """
import logging, time
from ttus_opt.live.peer import Outgoing
from ttus_opt.live.webrtc_link import WebRTCLink
logging.getLogger("asyncio").setLevel(logging.ERROR)  # it warns of a busy machine
there = WebRTCLink(bytes(32), "127.0.0.1", 0, calls=False)
here = WebRTCLink(bytes(32), "127.0.0.1", there.port, calls=True)
while b"to" not in there.receive(time.monotonic()):
    here.send(time.monotonic(), [Outgoing(b"to")])
    here.receive(time.monotonic())
    there.send(time.monotonic(), [])
    time.sleep(0.005)
"""


@pytest.mark.slow
@pytest.mark.parametrize("end", ["here.close(); there.close()", "there.close()", ""])
def test_nothing_is_said_at_exit(links, end):
    found = python("-X", "dev", "-c", EXIT + end)
    assert (found.stderr, found.stdout) == ("", "")


def test_without_the_package_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "aiortc", None)
    with pytest.raises(MissingPackageError, match=r'"ttus-opt\[webrtc\]"'):
        WebRTCLink(KEY, "127.0.0.1", 0, calls=False)


@pytest.mark.slow
def test_a_flood_does_not_queue(links):
    """1 kHz, a round trip of 200 ms, 1 % lost: without the gate seconds late."""
    way, took = Impairment(delay=0.1, loss=0.01), []
    here, there = pair(links, impairment=way)
    start = time.monotonic()
    while (now := time.monotonic()) < start + 8.0:
        here.send(now, [Outgoing(now.hex().encode().ljust(120))])
        arrived = there.receive(now)
        there.send(now, [Outgoing(data) for data in arrived if len(data) == 120])
        back = [data for data in here.receive(now) if len(data) == 120]
        now = time.monotonic()
        took += [now - float.fromhex(data.decode().strip()) for data in back]
        time.sleep(0.001)
    assert min(took) >= 0.2
    assert np.median(took) <= 0.2 + 0.05
    assert len(took) > 50 * 7  # more than a session sends
