"""What is used in ``with``, and closed at its end."""

from __future__ import annotations

from typing import Self


class Closing:
    """Closes itself however a ``with`` ends."""

    def close(self) -> None:
        """End it; a second call does nothing."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        """The object itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()
