"""Where breathing has moved the skin now, from what a camera saw a moment ago."""

from __future__ import annotations

from collections import deque

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError

#: Time over which the skin's motion is taken as straight; longest time to go on after
#: the newest image [s]
SPAN, AHEAD = 0.1, 0.2


class SkinMotion:
    """Displacement of the skin, continued along a line through the last images.

    A breath of 5 mm at 0.25 Hz moves the skin by 0.4 mm in the 50 ms that an image is
    old. A model takes that for the patient's stiffness: in `trial`, at a delay of a
    second, the hand then feels 0.9 N too much or too little. The line leaves 0.1 N.
    """

    def __init__(self) -> None:
        """A skin of which nothing was seen is at rest."""
        self._seen: deque[tuple[float, Array]] = deque()

    def see(self, time: float, displacement: Array) -> None:
        """Take an image; one that is not newer than the last is ignored.

        Args:
            time: When it was taken, by the follower's clock [s].
            displacement: Of the skin from rest, patient frame, shape (3,) [m].

        Raises:
            InputError: A displacement that is not three finite numbers.
        """
        shift = np.array(displacement, dtype=float)
        if shift.shape != (3,) or not np.isfinite([time, *shift]).all():
            raise InputError("a displacement of the skin must be three finite numbers")
        if self._seen and time <= self._seen[-1][0]:
            return
        self._seen.append((time, shift))
        while time - self._seen[0][0] > SPAN:
            self._seen.popleft()

    def at(self, time: float) -> Array:
        """Displacement at a time, shape (3,) [m]; least squares, at most `AHEAD` on."""
        if not self._seen:
            return np.zeros(3)
        times = np.array([seen for seen, _ in self._seen])
        shifts = np.array([shift for _, shift in self._seen])
        middle = float(times.mean())
        mean: Array = shifts.mean(axis=0)
        spread = float(np.sum((times - middle) ** 2))
        if spread == 0.0:
            return mean
        velocity: Array = (times - middle) @ (shifts - mean) / spread
        ahead = min(time, float(times[-1]) + AHEAD) - middle
        return np.asarray(mean + ahead * velocity)
