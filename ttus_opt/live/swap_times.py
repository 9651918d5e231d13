"""From contact to the operator's hand in real time: both sides over UDP on one machine.

Patient and haptic loop are a process each, as in a session, the operator is this one.
Their clocks are one, so that a sample's time says how long it took to change what the
hand feels. The session ends by the operator's button, a second before its time is over.
"""

from __future__ import annotations

import multiprocessing
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import NumericalError
from ttus_opt.live.follower import Follower
from ttus_opt.live.haptic_process import (
    SHARE,
    STOPPED,
    TAKEN,
    TIME,
    HapticProcess,
    LoopPlan,
)
from ttus_opt.live.impairment import Impairment, WorseLink
from ttus_opt.live.messages import MOST_TICKS, TICKS, Sample
from ttus_opt.live.model import LiveModel
from ttus_opt.live.numbering import later
from ttus_opt.live.operator import LiveState, Operator
from ttus_opt.live.real_time import (
    OperatorFrame,
    promptly,
    run_follower,
    run_operator,
)
from ttus_opt.live.sealing import new_key
from ttus_opt.live.socket_link import SocketLink
from ttus_opt.live.subject import example_subject
from ttus_opt.live.trial import Trial, prepared, simulated_patient, warm_up
from ttus_opt.voxmap.field import PotentialField

#: Force from which a sample counts as contact [N], above the noise; share of a field
#: that counts as felt [–]
CONTACT, MOST = 0.5, 0.9

#: Time after which the clock in packets begins again [s]
FULL = MOST_TICKS / TICKS

#: Time between the button and the session's end [s]
LAST = 1.0

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

    Attributes:
        fields: Number of every field published with news of a contact, and the time of
            its first such sample [s].
    """

    def __init__(self, plan: LoopPlan) -> None:
        super().__init__(plan)
        self.fields: list[tuple[int, float]] = []
        self._first = np.nan

    def measured(self, sample: Sample) -> None:
        """Note the first contact that the last field does not know."""
        touches = float(np.linalg.norm(sample.wrench[:3])) > CONTACT
        if touches and not self._first <= sample.time:
            self._first = sample.time

    def update(self, field: PotentialField) -> None:
        """Publish a field."""
        super().update(field)
        if np.isfinite(self._first):
            self.fields.append((self.published, self._first))
            self._first = np.nan

    def times(self, frames: Array, way: float) -> tuple[list[float], list[float]]:
        """`SwapTimes.begun` and ``felt``.

        Args:
            frames: All of the loop, shape (n, HAND).
            way: Delay of the link in one direction [s].
        """
        time, begun, felt = frames[:, TIME], [], []
        for number, first in self.fields:
            taken = np.flatnonzero(frames[:, TAKEN] >= number)
            if len(taken):
                at = float(time[taken[0]])
                # a sample's time is a clock of 32 bits
                begun.append(later(at, first, FULL) - way)
                whole = taken[frames[taken, SHARE] >= MOST]
                felt += (time[whole[:1]] - at).tolist()
        return begun, felt


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
    try:
        if not here.poll(START):
            raise NumericalError("the patient's side did not start, or died")
        return _operated(key, here.recv(), seconds, round_trip)
    finally:
        patient.terminate()
        patient.join()


def _patient(key: bytes, round_trip: float, end: Connection) -> None:
    """The patient's side, in its process."""
    who = example_subject()
    side = Follower(3, who.surface, prepared(1.6))
    patient = simulated_patient(Trial())
    warm_up()
    link = SocketLink(key, "127.0.0.1", 0, calls=False)
    worse = WorseLink(link, Impairment(delay=0.5 * round_trip))
    promptly()
    end.send(link.port)
    run_follower(side, worse, patient, *who.start)


def _operated(key: bytes, port: int, seconds: float, round_trip: float) -> SwapTimes:
    """The operator's side, in this process."""
    who = example_subject()
    warm_up()
    link = SocketLink(key, "127.0.0.1", port, calls=True)
    worse = WorseLink(link, Impairment(delay=0.5 * round_trip))
    newest = arrived = pressed = until = np.nan
    kept: list[Array] = []
    with TimedLoop(LoopPlan(who.shell, who.device())) as loop:

        def begin(model: LiveModel) -> HapticProcess:
            nonlocal arrived
            arrived = newest
            return loop.begin(model.field)

        def record(frame: OperatorFrame) -> None:
            nonlocal newest
            newest = frame.time if frame.packets else newest
            if frame.felt is not None:
                kept.append(frame.felt)

        def press(state: LiveState) -> None:
            nonlocal pressed, until
            if np.isnan(until):
                until = state.time + seconds - LAST
            if np.isnan(pressed) and state.time >= until:
                pressed = time.monotonic()
                side.stop()

        side = Operator(2, who.shell, feedback=begin)
        ended = run_operator(
            side, worse, who.start, seconds=seconds, show=press, record=record
        )
        frames = np.concatenate([*kept, loop.new_frames()])
    link.close()
    at = frames[:, TIME]
    let_go = at[(frames[:, STOPPED] > 0.0) & (at >= pressed)]
    rendered, stopped = at[0] - arrived, min(let_go, default=np.nan) - pressed
    times = loop.times(frames, 0.5 * round_trip)
    return SwapTimes(*times, float(rendered), float(stopped), ended.state)
