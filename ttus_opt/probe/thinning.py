"""Fewer frames of a dense recording: every n-th frame, or a given rate."""

from __future__ import annotations

import numpy as np

from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import Trajectory

#: Largest accepted rate [Hz]
HIGHEST = 1e9


def thinned(
    trajectory: Trajectory, *, every: int = 1, rate: float | None = None
) -> Trajectory:
    """Some of the frames of every recording, including its first; none is averaged.

    Args:
        trajectory: One recording or several.
        every: Keep every n-th frame [–].
        rate: Most frames per second of the recording, applied before ``every``; None
            for all [Hz].

    Raises:
        InputError: ``every`` is not a positive whole number, or ``rate`` is not
            positive or beyond `HIGHEST`.

    >>> from ttus_opt import example
    >>> from ttus_opt.probe.trajectory import read_trajectory
    >>> press = read_trajectory(example.path("press_fit.csv"))  # 20 s at 20 Hz
    >>> len(thinned(press, every=3)), len(thinned(press, rate=5.0))
    (134, 100)
    """
    if not (isinstance(every, int) and every >= 1):
        raise InputError(f"every must be a whole number of at least 1, got {every!r}")
    if rate is not None and not 0.0 < rate <= HIGHEST:
        raise InputError(
            f"rate must be positive and at most {HIGHEST:g} Hz, got {rate}"
        )
    kept = []
    for part in trajectory.parts:
        frames = np.arange(part.start, part.stop)
        if rate is not None:
            passed = trajectory.time[frames] - trajectory.time[frames[0]]
            # rounding of the times must not move a frame to the previous interval
            interval = np.floor(passed * rate + 1e-6)
            frames = frames[np.diff(interval, prepend=-1.0) > 0.0]
        kept.append(frames[::every])
    return trajectory.select(np.concatenate(kept))
