"""Numbers and words that options name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ttus_opt.core.errors import InputError

if TYPE_CHECKING:
    from ttus_opt.core.arrays import Array


def numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    """Numbers separated by commas.

    Args:
        text: As typed.
        count: How many there must be.
        option: For the message.

    Returns:
        The numbers.

    Raises:
        InputError: Another count, or no numbers.

    >>> numbers("0,0.5,1", 3, "--axis-origin")
    (0.0, 0.5, 1.0)
    """
    try:
        values = tuple(float(v) for v in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        raise InputError(
            f"{option} takes {count} numbers separated by commas, got {text!r}"
        )
    return values


def voxel_counts(text: str) -> tuple[int, int, int]:
    """Voxels in r, θ and z, as ``--shape`` gives them.

    Raises:
        InputError: Another count, or numbers with a fraction.
    """
    values = numbers(text, 3, "--shape")
    if any(not v.is_integer() for v in values):
        raise InputError(f"--shape takes whole numbers, got {text!r}")
    n_r, n_theta, n_z = map(int, values)
    return n_r, n_theta, n_z


def listed(text: str) -> tuple[str, ...]:
    """Words separated by commas.

    >>> listed("eq10, robust")
    ('eq10', 'robust')
    """
    return tuple(part.strip() for part in text.split(",") if part.strip())


def begin_apart(
    first: Sequence[float] | Array,
    second: Sequence[float] | Array,
    search: tuple[float, float],
) -> str:
    """What to try where the clocks of two recordings were not found.

    Args:
        first: Times of one [s].
        second: Times of the other [s].
        search: Middle and half width of the searched offsets [s].

    >>> begin_apart([1000.0], [0.0], (0.0, 5.0))
    '; give --together if both began at about the same time'
    >>> begin_apart([1000.0], [0.0], (1000.0, 5.0))
    ''
    """
    around, largest = search
    if abs(first[0] - second[0] - around) <= largest:
        return ""
    return "; give --together if both began at about the same time"
