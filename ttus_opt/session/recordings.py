"""Fifth step of a session: the recording is cut into trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.session.description import Part

#: Fewest frames of a stretch
LEAST_FRAMES = 10


def stretch(recorded: Trajectory, part: Part, begin: float) -> Trajectory:
    """The frames of a stretch, segments numbered from 0.

    Args:
        recorded: All frames.
        part: The stretch.
        begin: Time of the tracker's first pose [s].

    Raises:
        InputError: It has too few frames.
    """
    time = recorded.time - begin
    inside = (time >= part.start) & (time <= part.end)
    if inside.sum() < LEAST_FRAMES:
        raise InputError(
            f"{part.name} has {int(inside.sum())} frames from {part.start:g} to "
            f"{part.end:g} s, at least {LEAST_FRAMES} are needed: the recording runs "
            f"from {time[0]:.4g} to {time[-1]:.4g} s after the tracker's first pose"
        )
    out = recorded.select(inside)
    segment = np.unique(out.segment, return_inverse=True)[1]
    return replace(out, segment=segment.reshape(-1).astype(np.int64))


def cut(
    recorded: Trajectory, parts: Sequence[Part], begin: float
) -> dict[str, Trajectory]:
    """The recordings by name.

    Args:
        recorded: Contact wrenches, patient frame.
        parts: The stretches.
        begin: Time of the tracker's first pose [s].

    Raises:
        InputError: A stretch has too few frames, or one to fit to overlaps one to test
            on.
    """
    for fitted in parts:
        for other in parts:
            apart = fitted.end <= other.start or other.end <= fitted.start
            if fitted.fitted and not other.fitted and not apart:
                raise InputError(
                    f"{fitted.name} (fit) and {other.name} (test) overlap: a field is "
                    "tested on what it has not seen"
                )
    return {part.name: stretch(recorded, part, begin) for part in parts}
