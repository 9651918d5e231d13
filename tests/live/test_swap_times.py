"""Contact to hand in real time; how long that takes is the benchmark's matter."""

import numpy as np
import pytest

from tests.kit import NumericalError, refuses
from ttus_opt.live import swap_times
from ttus_opt.live.impairment import Impairment, WorseLink
from ttus_opt.live.peer import Outgoing


class Wire:
    """A link that keeps what was sent."""

    def __init__(self):
        self.sent = []

    def send(self, now, packets):
        self.sent += [(now, packet) for packet in packets]

    def receive(self, now):
        return [b"there"]


def test_a_worse_link_holds_packets_back():
    wire = Wire()
    link = WorseLink(wire, Impairment(delay=0.1))
    packets = Outgoing(b"a"), Outgoing(b"b", reliable=True)
    link.send(0.0, packets)
    link.send(0.09, ())
    assert wire.sent == []
    link.send(0.11, ())
    assert sorted(wire.sent, key=lambda one: one[1].data) == [
        (0.11, packet) for packet in packets
    ]
    assert link.receive(0.2) == [b"there"]


@pytest.mark.slow
def test_no_contact_is_known_before_it_can_be():
    found = swap_times.measure(8.0, 0.3)
    assert found.state == "STOP"  # by the button, at the end
    assert 0.0 < found.rendered < 5.0
    assert 0.0 < found.stopped < 1.0
    assert len(found.begun) > 20
    assert 0 <= len(found.begun) - len(found.felt) <= 3  # the last are on their way
    assert min(found.begun) > 0.0  # not before the way there has passed
    assert np.median(found.begun) < 5.0
    assert min(found.felt) >= 0.0


def test_a_side_that_does_not_start_is_said(monkeypatch):
    monkeypatch.setattr(swap_times, "START", 0.01)
    refuses(NumericalError, "did not start", swap_times.measure, 1.0, 0.1)
