"""From contact to the operator's hand in real time: both sides over UDP on one machine.

Patient, operator and haptic loop are a process each, as in a session. Their clocks are
one, so that a sample's time says how long it took to change what the hand feels. The
session ends by the operator's button, a second before its time is over.
"""

from __future__ import annotations

import multiprocessing
import time
from collections import deque
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection

import numpy as np

from ttus_opt.core.errors import NumericalError
from ttus_opt.live.follower import Follower
from ttus_opt.live.hand import Hand
from ttus_opt.live.haptic_process import STOPPED, TIME, HapticProcess, LoopPlan
from ttus_opt.live.impairment import Impairment
from ttus_opt.live.live_state import LiveState
from ttus_opt.live.messages import MOST_TICKS, TICKS, Sample
from ttus_opt.live.model import LiveModel
from ttus_opt.live.operator import Operator
from ttus_opt.live.real_time import promptly, run_follower, run_operator
from ttus_opt.live.safety import State
from ttus_opt.live.sealing import new_key
from ttus_opt.live.socket_link import SocketLink
from ttus_opt.live.subject import MEETING, example_subject
from ttus_opt.live.trial import Trial, prepared, simulated_patient, warm_up
from ttus_opt.live.worse_link import WorseLink
from ttus_opt.voxmap.field import PotentialField

#: Force from which a sample counts as contact [N], above the noise; share of a field
#: that counts as felt [–]
CONTACT, MOST = 0.5, 0.9

#: Time after which the clock in packets begins again [s]
FULL = MOST_TICKS / TICKS

#: Time between the button and the session's end [s]; frames of the haptic loop in it
LAST, LAST_FRAMES = 1.0, 1500

#: Time in which a side starts, compilation included, on a busy machine [s]
START = 120.0


@dataclass(frozen=True)
class SwapTimes:
    """Of every new field with a sample in contact; of the first model; of the button.

    Attributes:
        begun: From its first such sample to the hand's loop, less the way there [s].
        felt: From there until nine tenths of it, or of a newer one, are felt [s].
        rendered: From the first model's arrival to the haptic loop's first frame [s].
        stopped: From the button to that loop's first frame that lets go [s].
        state: Of the operator's side at the end.
    """

    begun: list[float]
    felt: list[float]
    rendered: float
    stopped: float
    state: str


class TimedLoop(HapticProcess):
    """A haptic loop whose fields are timed.

    Args:
        plan: See `HapticProcess`.
        way: Delay of the link in one direction [s].
    """

    def __init__(self, plan: LoopPlan, way: float) -> None:
        super().__init__(plan)
        self.begun: list[float] = []
        self.felt_after: list[float] = []
        self._way, self._first = way, np.nan
        self._published: deque[tuple[int, float]] = deque()  # number, first sample
        self._taken: deque[tuple[int, float]] = deque()  # number, when
        self.rendered = np.nan

    @property
    def stopped(self) -> float:
        """When the newest frames began to let go [s]; NaN where they do not."""
        newest = self._hand.since(max(self.frames - LAST_FRAMES, 0))
        times = newest[newest[:, STOPPED] > 0.0, TIME]
        return float(times[0]) if 0 < len(times) < len(newest) else np.nan

    def measured(self, sample: Sample) -> None:
        """Note the first contact that the last field does not know."""
        touches = float(np.linalg.norm(sample.wrench[:3])) > CONTACT
        if touches and not self._first <= sample.time:
            self._first = sample.time

    def update(self, field: PotentialField) -> None:
        """Publish a field."""
        super().update(field)
        if np.isfinite(self._first):
            self._published.append((self.published, self._first))
            self._first = np.nan

    def tell(self, friction: float, state: State) -> None:
        """Look at what the loop has taken, besides."""
        super().tell(friction, state)
        if not self.frames:
            return
        if np.isnan(self.rendered):
            self.rendered = float(self._hand.since(0)[0, TIME])
        (taken, share), now = self.swap, time.monotonic()
        while self._published and self._published[0][0] <= taken:
            number, first = self._published.popleft()
            # a sample's time is a clock of 32 bits
            took = (now - first + 0.5 * FULL) % FULL - 0.5 * FULL
            self.begun.append(took - self._way)
            self._taken.append((number, now))
        while self._taken and share >= MOST:
            self.felt_after.append(now - self._taken.popleft()[1])


class _Noted(WorseLink):
    """A link that knows when something arrived last."""

    newest = np.nan

    def receive(self, now: float) -> list[bytes]:
        """What has arrived."""
        arrived = super().receive(now)
        if arrived:
            self.newest = now
        return arrived


def measure(seconds: float, round_trip: float) -> SwapTimes:
    """A session of a simulated hand and patient in real time.

    Args:
        seconds: Length [s].
        round_trip: Delay of the link, there and back [s].

    Raises:
        NumericalError: A side died.
    """
    context, key = multiprocessing.get_context("spawn"), new_key()
    here, there = context.Pipe()
    patient = context.Process(
        target=_patient, args=(key, round_trip, there), daemon=True
    )
    patient.start()
    operator = None
    try:
        port = _answer(here)
        operator = context.Process(
            target=_operate, args=(key, port, seconds, round_trip, there)
        )
        operator.start()
        found = _answer(here, seconds)
    finally:
        for one in (patient, operator):
            if one is not None:
                one.terminate()
                one.join()
    assert isinstance(found, SwapTimes)
    return found


def _answer(end: Connection, seconds: float = 0.0) -> object:
    if not end.poll(START + seconds):
        raise NumericalError("a side of the session did not start, or died")
    return end.recv()


def _patient(key: bytes, round_trip: float, end: Connection) -> None:
    """The patient's side, in its process."""
    who = example_subject()
    side = Follower(3, who.surface, prepared(1.6))
    patient, path = simulated_patient(Trial()), who.examination()
    warm_up()
    link = SocketLink(key, "127.0.0.1", 0, calls=False)
    worse = WorseLink(link, Impairment(delay=0.5 * round_trip))
    promptly()
    end.send(link.port)
    run_follower(side, worse, patient, path.rotation[0], path.position[0])


def _operate(
    key: bytes, port: int, seconds: float, round_trip: float, end: Connection
) -> None:
    """The operator's side, in its process."""
    who = example_subject()
    path, shell = who.examination(), who.shell
    warm_up()
    plan = LoopPlan(shell, partial(Hand, path, again=MEETING))
    link = SocketLink(key, "127.0.0.1", port, calls=True)
    worse = _Noted(link, Impairment(delay=0.5 * round_trip))
    arrived = pressed = until = np.nan
    with TimedLoop(plan, 0.5 * round_trip) as loop:

        def begin(model: LiveModel) -> TimedLoop:
            nonlocal arrived
            arrived = worse.newest
            loop.begin(model.field)
            return loop

        def press(state: LiveState) -> None:
            nonlocal pressed, until
            if np.isnan(until):
                until = state.time + seconds - LAST
            if np.isnan(pressed) and state.time >= until:
                pressed = time.monotonic()
                side.stop()

        side = Operator(2, shell, feedback=begin)
        promptly()
        start = path.rotation[0], path.position[0]
        ended = run_operator(side, worse, start, seconds=seconds, show=press)
        rendered, stopped = loop.rendered - arrived, loop.stopped - pressed
    link.close()
    end.send(SwapTimes(loop.begun, loop.felt_after, rendered, stopped, ended.state))
