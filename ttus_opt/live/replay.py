"""A recorded session rendered again, from all that the operator's side was given.

Equal inputs give equal bits: what was felt is compared byte by byte. Of a session whose
hand and force were in a process of their own, the operator's steps give its fields, and
the haptic loop renders each of its frames with the field that it had taken by then.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.live.feedback import Feedback
from ttus_opt.live.haptic_process import (
    HAND,
    RUBS,
    SHOWN,
    STOPPED,
    TAKEN,
    TIME,
    WHOLE,
    Loop,
    LoopPlan,
)
from ttus_opt.live.operator import Operator
from ttus_opt.live.recording import Description, Frame, frames_of
from ttus_opt.live.trial import made_operator
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.field import PotentialField


@dataclass(frozen=True)
class Replay:
    """A session rendered again.

    Attributes:
        frames: Frames rendered [–].
        identical: Those whose six numbers are the same bit by bit [–].
        largest_difference: Of a component [N, N·m].
        description: What made the operator.
    """

    frames: int
    identical: int
    largest_difference: float
    description: Description


def replay(path: str | os.PathLike[str]) -> Replay:
    """Render a recorded session again.

    Raises:
        FileError: Not such a file, or a damaged one.
    """
    description, frames = frames_of(path)
    count = identical = 0
    largest = 0.0
    rendered = _apart if description.apart else _together
    for felt, then in rendered(description, frames):
        count += 1
        identical += felt.tobytes() == then.tobytes()
        largest = max(largest, float(np.abs(felt - then).max()))
    return Replay(count, identical, largest, description)


def _together(
    description: Description, frames: Iterator[Frame]
) -> Iterator[tuple[Array, Array]]:
    """What is felt now and was felt then, where the operator itself renders."""
    shell, epoch = description.shell, description.epoch
    operator = made_operator(description.comparator, shell, epoch)
    for frame in frames:
        pose = _pose(np.frombuffer(frame.pose).copy())
        operator.step(frame.time, frame.packets, *pose)
        yield operator.feel(frame.time, *pose), np.frombuffer(frame.felt)


def _apart(
    description: Description, frames: Iterator[Frame]
) -> Iterator[tuple[Array, Array]]:
    """The same, where the haptic loop is on its own."""
    again = _Again(description.shell)
    side = Operator(
        description.epoch,
        description.shell,
        feedback=lambda model: again.begin(model.field),
    )
    for frame in frames:
        for one in np.frombuffer(frame.felt).reshape(-1, HAND):
            yield again.rendered(one), one[SHOWN]
        pose = _pose(np.frombuffer(frame.pose).copy())
        side.step(frame.time, frame.packets, *pose)


def _pose(numbers: Array) -> tuple[Array, Array]:
    return numbers[:9].reshape(3, 3), numbers[9:12]


class _Again(Feedback):
    """The haptic loop, with fields as they were published, in place of its process.

    It is the loop's device as well, which is where it was.
    """

    rotation: Array
    position: Array

    def __init__(self, shell: PointShell) -> None:
        self._plan = LoopPlan(shell, lambda: self)
        self._fields: list[PotentialField] = []  # in shared memory
        self._whole: list[tuple[PotentialField, int]] = []  # and how many were before
        self._taken = self._came = 0

    def begin(self, field: PotentialField) -> _Again:
        """The first field."""
        self._loop, self._voxmap = Loop(self._plan, field), field.voxmap
        self._size = field.values.size
        return self

    def step(self, time: float, wrench: Array, seconds: float) -> None:
        """It moves with the next frame."""

    def update(self, field: PotentialField) -> None:
        """As `HapticProcess.update`."""
        if field.voxmap is self._voxmap and field.values.size == self._size:
            self._fields.append(field)
            return
        self._voxmap = field.voxmap
        self._whole.append((field, len(self._fields)))

    def rendered(self, then: Array) -> Array:
        """What reaches the hand in a recorded frame, shape (6,) [N, N·m]."""
        if then[WHOLE] > self._came:
            field, self._taken = self._whole[self._came]
            self._came += 1
            self._loop.replace(field)
        if then[TAKEN] > self._taken:
            self._taken = int(then[TAKEN])
            values = self._fields[self._taken - 1]
            flat = values.voxmap.grid.flatten(values.values)
            self._loop.renew(flat, float(then[RUBS]))
        self.rotation, self.position = _pose(then)
        return self._loop.frame(float(then[TIME]), bool(then[STOPPED]))[SHOWN]
