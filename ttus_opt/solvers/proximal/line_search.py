"""Line search for a convex function, by secants and bisection on its slope."""

from __future__ import annotations

from collections.abc import Callable

#: Final slope over the initial slope [–]
ENOUGH = 0.1

#: Most evaluations
MOST = 20

#: Distance of a secant step from the ends of the bracket, over its width [–]
MARGIN = 0.1


def along(slope: Callable[[float], float], start: float) -> tuple[float, float]:
    """A step length at which the slope is nearly zero.

    Args:
        slope: Slope at a step length, not decreasing.
        start: Slope at zero, negative.

    Returns:
        The step length, at most 1, and the slope there.
    """
    low, high = 0.0, 1.0
    at_low, at_high = start, slope(1.0)
    if at_high <= -ENOUGH * start:
        return 1.0, at_high
    step, now = high, at_high
    for _ in range(MOST):
        width = high - low
        step = low - at_low * width / (at_high - at_low)
        step = min(max(step, low + MARGIN * width), high - MARGIN * width)
        now = slope(step)
        if abs(now) <= -ENOUGH * start:
            break
        if now > 0.0:
            high, at_high = step, now
        else:
            low, at_low = step, now
    return step, now
