"""Real sockets on this machine."""

import errno
import socket
import struct
import time

import numpy as np
import pytest

from tests.kit import InputError, refuses
from tests.live.springy import Spring, parts, path, session
from ttus_opt.live.follower import Follower
from ttus_opt.live.operator import Operator
from ttus_opt.live.peer import Outgoing
from ttus_opt.live.safety import State
from ttus_opt.live.sealing import SealedChannel
from ttus_opt.live.session_stream import PROOF, STRANGERS, UNPROVED
from ttus_opt.live.socket_link import SocketLink
from ttus_opt.live.subject import Hand

KEY = bytes(range(32))


@pytest.fixture
def links():
    made = []

    def make(key=KEY, **options):
        made.append(SocketLink(key, "127.0.0.1", **options))
        return made[-1]

    yield make
    for link in made:
        link.close()


def until(condition, *sides):
    """What arrives at each side until something holds, for a minute at most."""
    end, got = time.monotonic() + 60.0, [[] for _ in sides]
    while not condition(got):
        now = time.monotonic()
        assert now < end, "nothing arrived"
        for side, own in zip(sides, got, strict=True):
            side.send(now, [])
            own += side.receive(now)
        time.sleep(0.001)
    return got


def test_datagrams_and_stream_arrive(links):
    there = links(port=0, calls=False)
    here = links(port=there.port, calls=True)
    large = bytes(100_000)
    here.send(0.0, [Outgoing(large, reliable=True)])

    def sent(got):
        here.send(time.monotonic(), [Outgoing(b"datagram")])
        there.send(time.monotonic(), [Outgoing(b"answer")])
        return large in got[1] and b"datagram" in got[1] and b"answer" in got[0]

    until(sent, here, there)


def test_a_free_port_is_free_for_datagrams_and_stream(links, monkeypatch):
    """A socket of another program has the port that was tried first."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        taken, opened = other.getsockname()[1], socket.create_server
        tried = []

        def at_the_taken_first(address):
            tried.append(address[1])
            host, port = address
            return opened((host, port if len(tried) > 1 else taken))

        monkeypatch.setattr(socket, "create_server", at_the_taken_first)
        there = links(port=0, calls=False)
        assert there.port != taken and tried == [0, 0]
        told = f"127.0.0.1:{taken} cannot be used"
        refuses(InputError, told, links, port=taken, calls=False)


def test_strangers_are_not_heard(links):
    there = links(port=0, calls=False)
    stranger = links(bytes(32), port=there.port, calls=True)
    plain = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for _ in range(200):
        now = time.monotonic()
        plain.sendto(b"anything", ("127.0.0.1", there.port))
        stranger.send(now, [Outgoing(b"x"), Outgoing(b"y", reliable=True)])
        assert there.receive(now) == []
        there.send(now, [])
        assert stranger.receive(now) == []
        time.sleep(0.001)
    plain.close()


def both_hear(here, there):
    """Until datagrams arrive on both sides."""

    def heard(got):
        for side in (here, there):
            side.send(time.monotonic(), [Outgoing(b"of 25 bytes or more, as ever")])
        return got[0] and got[1]

    until(heard, here, there)


def test_whose_answer_is_lost_asks_again(links):
    """An operator who comes after another one, over a link that loses a packet."""
    there = links(port=0, calls=False)
    both_hear(links(port=there.port, calls=True), there)
    send, lost = there._sendto, []
    there._sendto = lambda data, to=None: (
        send(data, to) if to is None or lost else lost.append(data)
    )
    both_hear(links(port=there.port, calls=True), there)
    assert lost


def test_a_follower_that_starts_again_is_met(links):
    there = links(port=0, calls=False)
    here = links(port=there.port, calls=True)
    both_hear(here, there)
    there.close()
    both_hear(here, links(port=there.port, calls=False))


def test_who_has_no_key_gets_no_more_than_he_sends(links):
    there = links(port=0, calls=False)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setblocking(False)
        sealed = b"TL" + bytes([1, 1]) + bytes(60)
        for data in (b"x", bytes(80), b"TL" + bytes([1, 0]) + bytes(48), sealed[:40]):
            stranger.sendto(data, ("127.0.0.1", there.port))
            for now in np.arange(5) * 0.06:
                there.receive(now)
                there.send(now, [Outgoing(b"report")])
            refuses(BlockingIOError, "", stranger.recv, 1000)
        stranger.sendto(sealed, ("127.0.0.1", there.port))
        there.receive(1.0)
        for now in (1.0, 1.25):
            there.send(now, [])
        assert len(stranger.recv(1000)) < len(sealed)
        refuses(BlockingIOError, "", stranger.recv, 1000)


def test_a_stream_that_no_side_of_ours_opened(links):
    there = links(port=0, calls=False)
    with socket.create_connection(("127.0.0.1", there.port)) as plain:
        plain.sendall(b"\xff\xff\xff\xff" + bytes(50))
        for _ in range(50):
            assert there.receive(time.monotonic()) == []
            there.send(time.monotonic(), [])
    here = links(port=there.port, calls=True)
    here.send(0.0, [Outgoing(b"model", reliable=True)])
    until(lambda got: b"model" in got[1], here, there)


def together(links):
    """A follower and an operator whose stream has carried a message."""
    there = links(port=0, calls=False)
    here = links(port=there.port, calls=True)
    here.send(0.0, [Outgoing(b"hello", reliable=True)])
    until(lambda got: b"hello" in got[1], here, there)
    return there, here


def recorded():
    """What an eavesdropper has of an earlier stream: greeting and proof, framed."""
    caller, called = (
        SealedChannel(KEY, calls=calls, purpose="stream") for calls in (True, False)
    )
    caller.open(called.greeting())
    packets = caller.greeting(), caller.seal(b"")
    return b"".join(struct.pack("<I", len(data)) + data for data in packets)


@pytest.mark.parametrize(
    "says", [b"", b"\xff" * 50, recorded()], ids=["silence", "noise", "recorded"]
)
def test_a_stranger_does_not_take_the_stream(links, says):
    there, here = together(links)
    now = time.monotonic()  # stands still: the operator does not call again
    with socket.create_connection(("127.0.0.1", there.port)) as stranger:
        stranger.sendall(says)
        end, arrived = now + 60.0, []
        there.receive(now)
        there.send(now, [Outgoing(b"model", reliable=True)])
        while b"model" not in arrived:
            assert time.monotonic() < end, "the operator's stream is gone"
            there.send(now, [])
            assert there.receive(now) == []
            here.send(now, [])
            arrived += here.receive(now)


def closed(stranger):
    """Whether the other side has closed this connection."""
    try:
        while stranger.recv(4096):
            pass
    except BlockingIOError:
        return False
    except ConnectionError:
        pass
    return True


def test_strangers_are_few_and_for_a_short_time(links):
    there = links(port=0, calls=False)
    address, now = ("127.0.0.1", there.port), 10.0
    strangers = [socket.create_connection(address) for _ in range(40)]
    for one in strangers:
        one.setblocking(False)
    for _ in range(5):
        assert there.receive(now) == []
    assert sum(not closed(one) for one in strangers) == STRANGERS
    here = links(port=there.port, calls=True)
    here.send(0.0, [Outgoing(b"model", reliable=True)])
    until(lambda got: b"model" in got[1], here, there)
    there.receive(time.monotonic() + 2.0 * PROOF)
    assert all(closed(one) for one in strangers)
    for one in strangers:
        one.close()


def test_little_of_a_stranger_is_read(links):
    there = links(port=0, calls=False)
    with socket.create_connection(("127.0.0.1", there.port)) as stranger:
        # a message that is announced and allowed, but never ends
        stranger.sendall(struct.pack("<I", UNPROVED * 2) + bytes(UNPROVED))
        stranger.setblocking(False)
        end = time.monotonic() + 60.0
        while not closed(stranger):
            assert time.monotonic() < end
            there.receive(10.0)


@pytest.mark.parametrize("fault", [errno.ENOBUFS, errno.ENETDOWN])
def test_a_datagram_that_the_system_drops_is_lost_and_ends_no_session(links, fault):
    class Full:
        def sendto(self, data, address):
            raise OSError(fault, "dropped")

    link = links(port=0, calls=False)
    with link._udp:
        link._udp = Full()
        link._sendto(b"packet", ("127.0.0.1", link.port))
        link.close = link._stream.close


def test_an_unusable_address(links):
    there = links(port=0, calls=False)
    refuses(InputError, "cannot be used", links, port=there.port, calls=False)


@pytest.mark.slow
def test_a_session_over_sockets_reaches_normal_and_survives_a_new_operator(links):
    survives_a_new_operator(links)


class Steady:
    """A clock that stands still while the machine does: that is no link's silence."""

    def __init__(self):
        self.now, self._seen = 0.0, time.monotonic()

    def __call__(self):
        seen = time.monotonic()
        self.now += min(seen - self._seen, 0.02)
        self._seen = seen
        return self.now


def survives_a_new_operator(links):
    """A session becomes NORMAL, stops without its operator, and begins with another."""
    surface, shell, content = parts()
    for _ in session().run(1.0):  # compiles all that follows, before a clock runs
        pass
    there = links(port=0, calls=False)
    follower, patient, hand = Follower(3, surface, content), Spring(), Hand(path())
    target, clock = (hand.rotation, hand.position), Steady()
    for epoch in (2, 4):
        here = links(port=there.port, calls=True)
        operator = Operator(epoch, shell)
        if follower.peer.safety.state is State.STOP:
            follower.rearm(0.0)
        end, met = clock() + 30.0, False
        while not met:
            now = clock()
            assert now < end, operator.peer.safety.cause
            sensed = patient.sense(now, *target)
            step = follower.step(now, there.receive(now), sensed)
            there.send(now, step.send)
            target = step.rotation, step.position
            pose = hand.rotation, hand.position
            here.send(now, operator.step(now, here.receive(now), *pose).send)
            operator.feel(now, *pose)
            met = operator.peer.safety.state is step.state is State.NORMAL
            time.sleep(0.002)
        assert operator.model is not None
        # the operator's process is gone
        end = clock() + 3.0
        while follower.peer.safety.state is not State.STOP:
            now = clock()
            assert now < end
            there.send(now, follower.step(now, there.receive(now), sensed).send)
            time.sleep(0.002)
    assert np.isfinite(target[1]).all()
