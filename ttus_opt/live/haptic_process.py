"""The haptic loop in its own process: hand, model, force, a thousand times a second.

The operator's process talks to the network and learns; it publishes every new field in
shared memory, and reads hand and force from there (`shared_arrays`), of every frame if
it records. A field is blended in within the loop. If the operator's process falls
silent, the loop stops by itself, as at a STOP, and ends.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import multiprocessing
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler

import numpy as np

from ttus_opt.contact.friction import FRICTION
from ttus_opt.core.arrays import Array
from ttus_opt.core.closing import Closing
from ttus_opt.core.errors import NumericalError
from ttus_opt.live.feedback import Feedback, ModelFeedback
from ttus_opt.live.real_time import HAPTIC, HandDevice, Lateness, Metronome, promptly
from ttus_opt.live.safety import Gate, SafetyLimits, State, is_pose
from ttus_opt.live.shared_arrays import SharedArray
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap

#: Numbers of a frame that the loop publishes: rotation, position, the wrench that was
#: rendered, what reached the hand of it; then those of `TAKEN` to `WHOLE`
HAND = 9 + 3 + 6 + 6 + 6
SHOWN = slice(18, 24)

#: Where they are: number of the field in shared memory that was taken last, share of
#: the last field that is felt, time [s], whether the side has stopped, friction, number
#: of fields that came whole
TAKEN, SHARE, TIME, STOPPED, RUBS, WHOLE = range(24, 30)

#: Frames that the operator's process may be behind before one is lost [–]: 4 s
BEHIND = 4096

#: Numbers that the operator publishes: heartbeat [s], state, friction
CONTROL = 3


@dataclass(frozen=True)
class LoopPlan:
    """What the loop's process is given.

    Attributes:
        shell: The probe.
        device: Makes the haptic device there; a function of a module.
        limits: When it stops by itself.
    """

    shell: PointShell
    device: Callable[[], HandDevice]
    limits: SafetyLimits = field(default_factory=SafetyLimits)


class HapticProcess(Feedback, Closing):
    """The operator's end of the loop, in place of a `ModelFeedback`.

    The process starts before a session, as that takes seconds; the loop begins with the
    first field. Use it in ``with``, or call `close`.
    """

    def __init__(self, plan: LoopPlan) -> None:
        """Start the process and wait until it is ready.

        Args:
            plan: What it is given.

        Raises:
            NumericalError: It died at once, for instance because its main module starts
                processes without ``if __name__ == "__main__"``.
        """
        given = ForkingPickler.dumps(plan)  # what cannot be sent starts nothing
        self._hand = SharedArray(HAND, depth=BEHIND)
        self._control, self._known = SharedArray(CONTROL), 0
        self._values: SharedArray | None = None
        self._voxmap: Voxmap | None = None
        self.lateness: Lateness | None = None
        context = multiprocessing.get_context("spawn")
        self._end, theirs = context.Pipe()
        names = self._hand.name, self._control.name
        self._process = context.Process(target=_run, args=(names, theirs), daemon=True)
        self._process.start()
        theirs.close()
        try:
            # not as an argument: `start` would wait for ever for a process that is dead
            self._end.send_bytes(given)
            self._end.recv()
        except (EOFError, OSError) as error:
            self.close()
            raise NumericalError("the haptic loop's process did not start") from error

    def begin(self, field: PotentialField) -> HapticProcess:
        """Begin the loop with a first field."""
        self._voxmap = field.voxmap
        self._values = SharedArray(field.voxmap.grid.n_voxels)
        self.tell(0.0, State.HOLD)
        self._send((field, self._values.name))
        return self

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.is_alive()

    @property
    def frames(self) -> int:
        """Frames of the loop so far [–]."""
        return self._hand.count

    def new_frames(self) -> Array:
        """Frames since the last call, shape (k, HAND).

        Raises:
            NumericalError: Some are lost: the last call was over 4 s ago.
        """
        frames = self._hand.since(self._known)
        self._known += len(frames)
        return frames

    @property
    def pose(self) -> tuple[Array, Array]:
        """The hand's rotation (3, 3) and position (3,) [m]; zeros before it runs."""
        numbers, _ = self._hand.read()
        return numbers[:9].reshape(3, 3), numbers[9:12]

    def tell(self, friction: float, state: State) -> None:
        """Publish a sign of life and this side's state."""
        self._control.write(np.array([time.monotonic(), float(state), friction]))

    def update(self, field: PotentialField) -> None:
        """Publish a field: its values, where the grid and the surface are the last.

        A field over another surface, or of another size than the first, goes through
        the pipe, whole.
        """
        assert self._values is not None
        fits = field.voxmap.grid.n_voxels == self._values.size
        if field.voxmap is self._voxmap and fits:
            self._values.write(field.voxmap.grid.flatten(field.values))
            return
        self._voxmap = field.voxmap
        self._send((field, self._values.count))

    def felt(self, now: float, rotation: Array, position: Array) -> Array:
        """What was rendered last, at the hand's own pose, shape (6,) [N, N·m]."""
        return self._hand.read()[0][12:18]

    @property
    def published(self) -> int:
        """Fields published in shared memory so far [–]."""
        return 0 if self._values is None else self._values.count

    def close(self) -> None:
        """End the loop; `lateness` tells then how late its frames were."""
        if self._end.closed:
            return
        self._send(None)
        with contextlib.suppress(EOFError, OSError):
            if self._end.poll(2.0):
                self.lateness = self._end.recv()
        self._process.join(1.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._end.close()
        for one in (self._hand, self._control, self._values):
            if one is not None:
                one.close()

    def _send(self, message: object) -> None:
        with contextlib.suppress(OSError):  # a loop that died is noticed by `alive`
            self._end.send(message)


def _run(names: tuple[str, str], end: Connection) -> None:
    """The loop, in its process.

    Ctrl-C reaches this process as well; the operator's ends it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    plan: LoopPlan = end.recv()
    hand = SharedArray(HAND, names[0], depth=BEHIND)
    control = SharedArray(CONTROL, names[1])
    _warm_up(plan.shell)
    end.send("ready")
    try:
        first = end.recv()
    except EOFError:  # the operator's process is gone
        first = None
    if first is not None:
        begun, name = first
        with SharedArray(begun.voxmap.grid.n_voxels, name) as values:
            promptly(HAPTIC)
            late = _beat(Loop(plan, begun), hand, control, values, end)
        with contextlib.suppress(OSError):
            end.send(late)
    hand.close()
    control.close()


def _warm_up(shell: PointShell) -> None:
    """Compile all that frames use, so that a first model is felt at once."""
    skin = Surface.from_radius(np.full((8, 4), 0.2), np.linspace(0.0, 0.3, 4))
    voxmap = Voxmap.from_surface(skin, shape=(8, 8, 4), r_inner=0.02)
    field = PotentialField(voxmap, np.zeros(voxmap.grid.shape), "trilinear", {}, {})
    feedback, inside = ModelFeedback(field, shell), np.array([0.19, 0.0, 0.15])
    for k in range(3):
        feedback.felt(1e-3 * k, np.eye(3), inside)
        feedback.update(field)


def _beat(
    loop: Loop,
    hand: SharedArray,
    control: SharedArray,
    values: SharedArray,
    end: Connection,
) -> Lateness:
    """Frames until the end is told, or nobody is there any more.

    Whatever ends them, the device is shown no force last.
    """
    beat, seen, gone = Metronome(1000.0), 0, False
    whole = 0
    try:
        for now in beat:
            if not gone and end.poll():
                try:
                    message = end.recv()
                except (EOFError, OSError):  # the operator's process is gone
                    message = None
                gone = message is None
                if message is not None:
                    patient, seen = message  # values before it are of another surface
                    loop.replace(patient)
                    whole += 1
            told, _ = control.read()
            if values.count > seen:
                new, seen = values.read()
                loop.renew(new, float(told[2]))
            silent = gone or now - told[0] >= loop.plan.limits.stop_seconds
            stopped = silent or told[1] == State.STOP
            frame = loop.frame(now, stopped)
            more = seen, loop.share, now, stopped, told[2], whole
            hand.write(np.concatenate([frame, more]))
            if silent and loop.gate.gain == 0.0:
                break
    finally:
        loop.let_go()
    return beat.lateness


class Loop:
    """Device, model and gate of the loop; a replay's device has the poses of then."""

    def __init__(self, plan: LoopPlan, start: PotentialField) -> None:
        self.plan = plan
        self._device, self._field = plan.device(), start
        self._feedback = ModelFeedback(start, plan.shell)
        self.gate = Gate(plan.limits.contact)
        self._begun, self._last = math.nan, 0.0

    @property
    def share(self) -> float:
        """Share of the last field that is felt [–]."""
        return self._feedback.blend.progress

    def renew(self, values: Array, friction: float) -> None:
        """Blend new values in."""
        old = self._field
        parameters = {FRICTION: friction} if friction > 0.0 else {}
        shaped = old.voxmap.grid.unflatten(values)
        self.replace(dataclasses.replace(old, values=shaped, parameters=parameters))

    def replace(self, field: PotentialField) -> None:
        """Blend another field in, over the same or another surface.

        One that cannot be rendered ends the loop, which the operator answers by STOP.
        """
        self._feedback.update(field)
        self._field = field

    def let_go(self) -> None:
        """Show the device no force; the last that it is shown."""
        self._device.step(self._last, np.zeros(6), 1e-3)

    def frame(self, now: float, stopped: bool) -> Array:
        """One frame: pose, rendered wrench, and what reached the hand, (24,).

        At what is no pose nothing is felt, until the hand was lifted once.
        """
        device = self._device
        if math.isnan(self._begun):
            self._begun = now
        pose = device.rotation, device.position.copy()
        known = is_pose(*pose)
        rendered = self._feedback.felt(now, *pose) if known else np.zeros(6)
        shown = self.gate(now, rendered, stopped or not known)
        self._last = now - self._begun
        device.step(self._last, shown, 1e-3)
        return np.concatenate([pose[0].ravel(), pose[1], rendered, shown])
