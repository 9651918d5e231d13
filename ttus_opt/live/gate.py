"""When a rendered force may reach the hand."""

from __future__ import annotations

from ttus_opt.core.arrays import Array

#: Time in which the force falls to zero at a STOP [s]
RELEASE = 0.05


class Gate:
    """Lets no force appear from nothing, and takes it away at a STOP.

    It opens when the model gives no force: before, the probe was not lifted since the
    model arrived or the side was re-armed. At a STOP the force falls to zero within
    `RELEASE`, from wherever it is.

    Attributes:
        gain: Share of the force that passes [–].
    """

    def __init__(self, contact: float) -> None:
        """A closed gate; below ``contact`` [N] there is no contact."""
        self._contact, self.gain = contact, 0.0
        self._before: float | None = None

    def __call__(self, now: float, wrench: Array, stopped: bool) -> Array:
        """What reaches the hand of a wrench, shape (6,) [N, N·m].

        Args:
            now: Time [s].
            wrench: Rendered, shape (6,).
            stopped: Whether the side is in STOP.
        """
        if stopped:
            passed = 0.0 if self._before is None else now - self._before
            self.gain, self._before = max(0.0, self.gain - passed / RELEASE), now
        else:
            is_open = self.gain == 1.0 and self._before is None
            lifted = wrench[:3] @ wrench[:3] < self._contact**2
            self.gain, self._before = (1.0 if is_open or lifted else 0.0), None
        return self.gain * wrench
