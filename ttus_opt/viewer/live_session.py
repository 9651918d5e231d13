"""A simulated live session in step with the clock on the wall, for a page.

The simulated hand presses, or goes where a visitor leads it. Frames are computed in
batches in one thread; if the machine is too slow, the session runs slower than time.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.live.operator import LiveState
from ttus_opt.live.safety import State
from ttus_opt.live.subject import MEETING, Hand, Subject, example_subject
from ttus_opt.live.trial import Trial, simulation
from ttus_opt.voxmap.field import PotentialField

#: Time between batches of frames, and how far the session may fall behind [s]
BATCH, BEHIND = 0.033, 0.2

#: Share of the measured force that a batch takes into its mean [–]: 0.3 s
SHARE = 0.1

#: Samples that are remembered for a plot [–]: at most 50 a second
REMEMBERED = 500


class LedHand(Hand):
    """A hand that examines again and again, until somebody leads it.

    Attributes:
        lead: Where it is led, rotation (3, 3) and position (3,) [m]; None to examine.
    """

    lead: tuple[Array, Array] | None = None

    def wanted(self, time: float) -> tuple[Array, Array]:
        """Intended position and velocity."""
        if self.lead is not None:
            self.rotation, place = self.lead
            return place, np.zeros(3)
        return super().wanted(time)


class LiveSession:
    """A session that runs until it is closed; any thread may call any method.

    Attributes:
        trial: What is simulated.
        subject: Who is examined.
        speed: Of the session's time over that on the wall [–].
        samples: Time [s], measured force, and the force that the hand's model gives at
            the same pose [N], of the last samples.
    """

    def __init__(self, trial: Trial, subject: Subject | None = None) -> None:
        """A session that has met, and has its model; by default with the example."""
        self._given, self.subject = subject, subject or example_subject()
        self.samples: deque[tuple[float, float, float]] = deque(maxlen=REMEMBERED)
        self._lock, self._closing = threading.RLock(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.speed = 1.0
        self.restart(trial)

    def restart(self, trial: Trial) -> None:
        """Begin again, with the prior of a trial."""
        begun = simulation(trial, self._given)
        begun.hand = hand = LedHand(self.subject.examination(), again=MEETING)
        for _ in begun.run(5.0):
            if begun.operator.model is not None:
                break
        else:
            raise InputError("no model arrived within 5 s: the link is too bad")
        with self._lock:
            self.trial, self._session, self.hand = trial, begun, hand
            self.samples.clear()
            self._measured = np.zeros(3)

    def worsen(self, **changes: float) -> None:
        """Change the link from now on: ``round_trip`` [s], ``loss``, ``jitter`` [s]."""
        with self._lock:
            self.trial = replace(self.trial, **changes)  # type: ignore[arg-type]
            self._session.worsen(self.trial.impairment())

    def stop(self) -> None:
        """Press the operator's button."""
        with self._lock:
            self._session.operator.stop()

    def rearm(self) -> None:
        """Re-arm the sides that have stopped.

        Raises:
            InputError: There is contact, on either side, or nothing to re-arm.
        """
        with self._lock:
            operator, follower = self._session.operator, self._session.follower
            waits = follower.peer.safety.state is State.STOP
            if operator.peer.safety.state is State.STOP or not waits:
                operator.rearm(self.hand.rotation, self.hand.position)
            if waits:
                follower.rearm(float(np.linalg.norm(self._measured)))

    @property
    def field(self) -> PotentialField:
        """The operator's present model."""
        with self._lock:
            model = self._session.operator.model
            assert model is not None
            return model.field

    @property
    def learned(self) -> int:
        """Samples that the model has learned from [–]."""
        return self._session.operator.folded

    def view(self) -> LiveState:
        """The present moment at the operator."""
        with self._lock:
            return self._session.operator.view(self._session.time)

    def start(self, show: Callable[[], None]) -> None:
        """Run, and call something after every batch of frames."""
        self._show = show
        self._thread.start()

    def close(self) -> None:
        """End it."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    def _run(self) -> None:
        last = time.monotonic()
        while not self._closing.wait(BATCH):
            now = time.monotonic()
            with self._lock:
                # what cannot be caught up is dropped
                passed = min(now - last, BEHIND)
                for _ in self._session.run(passed):
                    pass
                self._remember()
            self.speed += SHARE * (passed / (now - last) - self.speed)
            last = now
            self._show()

    def _remember(self) -> None:
        sensed = self._session.sensed
        if sensed is not None:  # without the sensor's noise
            self._measured += SHARE * (sensed.wrench[:3] - self._measured)
        view = self._session.operator.view(self._session.time)
        sample, there = view.measured, view.felt_there
        if sample is None or there is None:
            return
        if self.samples and sample.time <= self.samples[-1][0]:
            return
        measured, felt = (
            float(np.linalg.norm(force)) for force in (sample.wrench[:3], there)
        )
        self.samples.append((sample.time, measured, felt))
