"""Loops in virtual time: their beat, and that a follower retracts before it ends."""

import numpy as np
import pytest

from tests.live.springy import BALL, RADIUS, Spring, parts
from ttus_opt.core.errors import TtusWarning
from ttus_opt.live import real_time
from ttus_opt.live.follower import Follower
from ttus_opt.live.operator import Operator


class VirtualTime:
    """A clock that goes on when it is read, and by sleeping."""

    now = 100.0

    def monotonic(self):
        self.now += 1e-5
        return self.now

    def sleep(self, seconds):
        self.now += seconds


class Pressed(Spring):
    """Remembers its forces; answers so many times at most."""

    def __init__(self, most=10_000):
        self.forces, self.most = [], most

    def sense(self, time, rotation, position):
        if len(self.forces) == self.most:
            raise OSError("the driver is gone")
        found = super().sense(time, rotation, position)
        self.forces.append(float(np.linalg.norm(found.wrench[:3])))
        return found


class Led:
    """An operator at the other end of a perfect link, whose hand presses 20 mm deep."""

    overhead = 0

    def __init__(self, interrupted=np.inf):
        self.operator, self.arrived = Operator(2, parts()[1]), []
        self.left = interrupted

    def send(self, now, packets):
        self.arrived += [one.data for one in packets]

    def receive(self, now):
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        pressed = np.eye(3), np.array([RADIUS + BALL - 0.02, 0.0, 0.15])
        sent = self.operator.step(now, tuple(self.arrived), *pressed).send
        self.arrived.clear()
        return [one.data for one in sent]


@pytest.fixture
def ending(monkeypatch):
    """Runs a follower's loop in virtual time from above the skin."""
    monkeypatch.setattr(real_time, "time", VirtualTime())

    def run(patient, link, seconds=3.0):
        surface, _, content = parts()
        start = np.eye(3), np.array([RADIUS + BALL + 0.01, 0.0, 0.15])
        side = Follower(3, surface, content)
        return real_time.run_follower(side, link, patient, *start, seconds=seconds)

    return run


def test_a_follower_whose_loop_ends_retracts_first(ending):
    patient = Pressed()
    ended = ending(patient, Led())
    assert (ended.state, ended.cause) == ("NORMAL", "")
    assert patient.forces[300] == pytest.approx(10.0)  # at the end of 3 s
    assert patient.forces[-1] <= 0.1
    assert len(patient.forces) == pytest.approx(300 + 0.02 / 0.05 * 100, abs=4)


def test_a_follower_that_is_interrupted_retracts_first(ending):
    patient = Pressed()
    with pytest.raises(KeyboardInterrupt):
        ending(patient, Led(interrupted=200))
    assert patient.forces[200] == pytest.approx(10.0)
    assert patient.forces[-1] <= 0.1


def test_frames_that_were_missed_are_not_made_up_for(monkeypatch):
    """After a pause, as by Ctrl-Z, a device is not driven faster than in time."""
    times, clock = [], VirtualTime()
    monkeypatch.setattr(real_time, "time", clock)
    for now in real_time.Metronome(1000.0, 0.5):
        times.append(now)
        if len(times) == 50:
            clock.sleep(0.3)
    assert len(times) == pytest.approx(200, abs=2)
    assert times[-1] - times[0] == pytest.approx(0.5, abs=2e-3)


def test_a_retraction_ends_with_the_driver_or_where_force_says_nothing(ending):
    gone = Pressed(most=310)
    with pytest.warns(TtusWarning, match="not retracted .the driver is gone.: lift"):
        assert ending(gone, Led()).state == "NORMAL"
    assert len(gone.forces) == 310
    stuck = Pressed()
    stuck.wrench = [5.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    ending(stuck, Led())
    assert len(stuck.forces) == pytest.approx(300 + 0.08 / 0.05 * 100, abs=4)
