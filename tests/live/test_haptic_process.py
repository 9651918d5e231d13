"""The loop's own process: shared memory, and what it does when it is left alone."""

import dataclasses
import os
import signal
import time
from functools import partial

import numpy as np
import pytest

from tests.kit import python
from tests.live.springy import BALL, RADIUS, Spring, parts, path
from ttus_opt.live.follower import Follower
from ttus_opt.live.haptic_process import (
    SHOWN,
    TAKEN,
    TIME,
    WHOLE,
    HapticProcess,
    Loop,
    LoopPlan,
)
from ttus_opt.live.messages import ModelMessage
from ttus_opt.live.model import decode_model
from ttus_opt.live.operator import Operator
from ttus_opt.live.real_time import run_operator
from ttus_opt.live.recording import Description, Recorder
from ttus_opt.live.replay import replay
from ttus_opt.live.safety import Gate, SafetyLimits, State
from ttus_opt.live.subject import Hand
from ttus_opt.message import decode, encode


class Still:
    """A device that stays lifted for a moment, then in the patient."""

    def __init__(self, depth=0.01):
        self.rotation, self._depth = np.eye(3), depth
        self.position = np.array([RADIUS + BALL + 0.01, 0.0, 0.15])

    def step(self, time, wrench, seconds):
        if time > 0.05:
            self.position[0] = RADIUS + BALL - self._depth


#: Of loops whose operator falls silent only where the machine stands still
PATIENT = SafetyLimits(stop_seconds=20.0)


def plan(limits=PATIENT):
    _, shell, (sent, model) = parts()
    found = decode_model(ModelMessage(model).content, decode(sent), shell)
    return found, LoopPlan(shell, partial(Still), limits=limits)


def test_a_device_is_shown_force_and_torque():
    model, given = plan()
    device, shown = Still(), []
    device.step = lambda time, wrench, seconds: shown.append(wrench)
    loop = Loop(dataclasses.replace(given, device=lambda: device), model.field)
    for k in range(10):
        frame = loop.frame(1e-3 * k, stopped=False)
        device.position[0] = RADIUS + BALL - 0.01
    np.testing.assert_array_equal(shown[-1], frame[SHOWN])
    assert np.linalg.norm(shown[-1][:3]) > 1.0


@pytest.mark.parametrize("turn", [np.nan, 0.0, -1.0])
def test_at_what_is_no_pose_nothing_is_felt_until_the_hand_was_lifted(turn):
    model, given = plan()
    device, shown = Still(), []
    device.step = lambda time, wrench, seconds: shown.append(wrench[0])
    loop = Loop(dataclasses.replace(given, device=lambda: device), model.field)
    lifted = RADIUS + BALL + 0.01
    for k, x in enumerate([lifted, 0.11, np.nan, 0.11, lifted, 0.11]):
        device.rotation = (turn if np.isnan(x) else 1.0) * np.eye(3)
        device.position[0] = 0.11 if np.isnan(x) else x
        loop.frame(1e-3 * k, stopped=False)
    assert np.isfinite(shown).all()
    assert [force > 1.0 for force in shown] == [False, True, False, False, False, True]


class Noting(Still):
    """A device that writes down the force that it shows."""

    def __init__(self, file, fails=None):
        super().__init__()
        self._file, self._fails = file, fails

    def step(self, time, wrench, seconds):
        super().step(time, wrench, seconds)
        if seconds and self._fails and time > self._fails:
            self._fails = None
            raise OSError("the device does not answer")
        with self._file.open("a") as file:
            file.write(f"{np.linalg.norm(wrench)}\n")


def shown(loop):
    """What reached the hand of the last frame."""
    return loop._hand.read()[0][SHOWN]


@pytest.mark.slow
@pytest.mark.parametrize("how", ["end", "fault", "SIGTERM", "SIGINT"])
def test_whatever_ends_the_loop_no_force_is_shown_last(how, tmp_path):
    model, given = plan()
    file = tmp_path / "shown"
    fails = 0.3 if how == "fault" else None
    device = partial(Noting, file, fails)
    with HapticProcess(dataclasses.replace(given, device=device)) as loop:
        loop.begin(model.field)
        until(lambda: np.linalg.norm(shown(loop)) > 1.0, loop)
        if how.startswith("SIG"):
            os.kill(loop._process.pid, getattr(signal, how))
        if how == "SIGINT":  # Ctrl-C is the operator's
            end = time.monotonic() + 0.5
            until(lambda: time.monotonic() > end, loop)
            assert loop.alive
        elif how != "end":
            until(lambda: not loop.alive, loop)
    forces = [float(force) for force in file.read_text().split()]
    assert max(forces) > 1.0
    assert forces[-1] == 0.0
    if how == "end":  # not at once
        assert any(0.0 < force < 0.9 * max(forces) for force in forces[-60:])


def test_a_process_that_dies_at_once_is_said_though_the_probe_is_large(tmp_path):
    """Without a guard; the plan is more than a pipe holds."""
    file = tmp_path / "unguarded.py"
    file.write_text(
        "import ttus_opt as tt\n"
        "from ttus_opt.live.haptic_process import HapticProcess, LoopPlan\n"
        "shell = tt.PointShell.ellipsoid((0.02, 0.01, 0.01), n_points=5000)\n"
        "HapticProcess(LoopPlan(shell, int))\n"
    )
    told = python(file, status=1, timeout=120.0)
    assert "NumericalError: the haptic loop's process did not start" in told.stderr


def until(condition, loop, state=State.NORMAL, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        loop.tell(0.0, state)
        time.sleep(0.002)


@pytest.mark.slow
def test_fields_that_are_published_are_felt_and_a_stop_takes_the_force_away():
    model, given = plan()
    with HapticProcess(given).begin(model.field) as loop:

        def force():
            return float(np.linalg.norm(shown(loop)[:3]))

        until(lambda: force() > 0.5, loop)
        before = force()
        soft = model.learner.field_of(model.learner.state)
        soft.values[:] *= 0.5
        loop.update(soft)
        until(lambda: abs(force() - 0.5 * before) < 0.02, loop)
        loop.update(model.field)
        until(lambda: abs(force() - before) < 0.02, loop)
        seen = model.surface  # another one reaches it whole
        lower = dataclasses.replace(seen, radius=seen.radius - 0.005)
        loop.update(model.over(lower).field)
        until(lambda: force() < 0.7 * before, loop)
        until(lambda: force() == 0.0, loop, State.STOP)
        pressed = loop.felt(0.0, np.eye(3), np.zeros(3))
        assert np.linalg.norm(pressed[:3]) > 0.2  # no re-arming before it is lifted
        assert loop.frames > 50
        np.testing.assert_allclose(loop.pose[1][0], RADIUS + BALL - 0.01)


@pytest.mark.slow
def test_it_stops_and_ends_by_itself_when_the_operator_is_gone():
    model, given = plan(SafetyLimits())
    loop = HapticProcess(given).begin(model.field)
    try:
        until(lambda: loop.frames > 100 or not loop.alive, loop)
        loop._process.join(10.0)  # no sign of life any more
        assert not loop._process.is_alive()
        assert not shown(loop).any()
    finally:
        loop.close()


def test_the_gate():
    gate, press, lifted = Gate(0.2), np.array([5.0, 0, 0, 0, 0, 0]), np.zeros(6)
    assert gate(0.0, press, False)[0] == 0.0  # never lifted yet
    gate(0.001, lifted, False)
    assert gate(0.002, press, False)[0] == 5.0
    falling = [gate(0.002 + 0.01 * k, press, True)[0] for k in range(7)]
    assert falling[0] == 5.0
    assert (np.diff(falling[:6]) < 0.0).all()
    assert falling[-1] == 0.0
    assert gate(0.1, press, False)[0] == 0.0  # re-armed: lift first
    gate(0.101, lifted, False)
    assert gate(0.102, press, False)[0] == 5.0


def test_a_gate_that_is_still_falling_does_not_open_again_in_contact():
    gate, press = Gate(0.2), np.array([5.0, 0, 0, 0, 0, 0])
    gate(0.0, np.zeros(6), False)
    gate(0.01, press, True)
    gate(0.02, press, True)
    assert gate(0.03, press, False)[0] == 0.0


def test_a_simulated_hand_is_a_device():
    hand = Hand(path())
    for k in range(100):
        hand.step(1e-3 * k, np.zeros(6), 1e-3)
    assert hand.position[0] == pytest.approx(RADIUS + BALL + 0.005, abs=1e-6)


class Loopback:
    """A link to a follower that takes its step at once."""

    overhead = 0

    def __init__(self):
        surface, _, content = parts()
        self.follower, self.patient = Follower(3, surface, content), Spring()
        self._target = np.eye(3), path().position[0]
        self._there, self.late = [], ()

    def send(self, now, packets):
        self._there += [packet.data for packet in packets]

    def receive(self, now):
        sensed = self.patient.sense(now, *self._target)
        step = self.follower.step(now, self._there, sensed)
        self._target, self._there = (step.rotation, step.position), []
        more, self.late = self.late, ()
        return [packet.data for packet in (*step.send, *more)]


@pytest.mark.slow
def test_a_recorded_session_is_rendered_again_bit_by_bit(tmp_path):
    """Every frame of the loop, with fields of another surface in between."""
    pytest.importorskip("mcap.reader", reason="needs mcap")
    shell, link = parts()[1], Loopback()
    file = tmp_path / "session.mcap"
    described = Description(f"sphere:{BALL}", 200, epoch=2, apart=True)
    hand = partial(Hand, path(lifted=0.2, period=1.0))
    plan = LoopPlan(shell, hand, limits=PATIENT)
    start, frames = (np.eye(3), path().position[0]), []

    class EnoughError(Exception):
        pass

    def record(frame):
        if len(frames) == 300:
            lower = dataclasses.replace(parts()[0], radius=parts()[0].radius - 0.002)
            link.late = link.follower.renew(frame.time, encode(lower), parts()[2][1])
        frames.append(frame)
        recorder.operated(frame)
        felt = [] if frame.felt is None else frame.felt[:, WHOLE]
        if len(frames) > 800 and any(felt):  # of the other surface
            raise EnoughError

    with Recorder(file, described) as recorder, HapticProcess(plan) as loop:
        side = Operator(2, shell, feedback=lambda model: loop.begin(model.field))
        with pytest.raises(EnoughError):
            run_operator(side, link, start, seconds=60.0, record=record)
    felt = np.concatenate([f.felt for f in frames if f.felt is not None])
    assert felt[:, SHOWN].max() > 1.0
    assert felt[-1, TAKEN] > 5
    assert felt[-1, WHOLE] >= 1
    assert (np.diff(felt[:, TIME]) > 0.0).all()
    found = replay(file)
    assert (found.frames, found.identical) == (len(felt), len(felt))


@pytest.mark.slow
def test_a_session_with_the_loop_in_its_own_process_and_its_death():
    killed = []

    class StopError(Exception):
        pass

    def show(view):
        if view.state == "STOP":
            raise StopError(view.cause)
        if view.folded > 10 and view.force[0] > 1.0 and not killed:
            killed.append(view)
            loop._process.kill()

    shell = parts()[1]
    hand = partial(Hand, path(lifted=0.2, period=1.0))
    plan = LoopPlan(shell, hand, limits=PATIENT)
    with HapticProcess(plan) as loop:
        operator = Operator(2, shell, feedback=lambda model: loop.begin(model.field))
        start = np.eye(3), path().position[0]
        with pytest.raises(StopError, match="the haptic loop has died"):
            run_operator(operator, Loopback(), start, seconds=30.0, show=show)
    assert loop.lateness is None
    assert killed[0].state == "NORMAL"
