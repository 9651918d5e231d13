"""Numbers of packets: none counts twice, and one of a circle is later than another."""

from __future__ import annotations

from typing import TypeVar

Number = TypeVar("Number", int, float)


class Once:
    """Which numbers have come, within a window behind the newest.

    Attributes:
        newest: The largest; 0 before the first.
    """

    def __init__(self, window: int) -> None:
        """What is as far behind the newest as ``window`` counts as having come."""
        self._window, self.newest = window, 0
        self._come: set[int] = set()

    def __contains__(self, number: int) -> bool:
        """Whether a number has come, or would be too late."""
        return number <= self.newest - self._window or number in self._come

    def add(self, number: int) -> bool:
        """Note a number; whether it is new."""
        if number in self:
            return False
        self._come.add(number)
        self.newest = max(self.newest, number)
        if len(self._come) > 2 * self._window:
            self._come = {n for n in self._come if n > self.newest - self._window}
        return True


def later(number: Number, before: Number, circle: Number) -> Number:
    """By how much a number is later than another, where both begin anew at some size.

    >>> later(2, 65535, 2**16), later(65535, 2, 2**16)
    (3, -3)
    """
    half = circle // 2
    return (number - before + half) % circle - half
