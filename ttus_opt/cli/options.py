"""Numbers and words that options name."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from ttus_opt.cli.console import as_options
from ttus_opt.core.errors import InputError, TtusError


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


@contextlib.contextmanager
def compared_clocks(
    begun: tuple[float, float],
    search: tuple[float, float],
    advice: str = "",
) -> Iterator[None]:
    """Tell by options what to try where the clocks of two recordings were not found.

    Args:
        begun: Times of their first frames [s].
        search: The offset around which was searched, and how far [s].
        advice: What else to try where the signals are unlike.
    """
    from ttus_opt.sensors.clock import UnlikeSignalsError

    try:
        yield
    except UnlikeSignalsError as error:
        if abs(begun[0] - begun[1] - search[0]) > search[1]:
            advice = f"; give --together if both began at about the same time{advice}"
        raise InputError(f"{error}{advice}") from error


@contextlib.contextmanager
def told_by(**options: str) -> Iterator[None]:
    """Tell errors by these options, by the names that the library's messages give."""
    try:
        yield
    except TtusError as error:
        raise InputError(as_options(str(error), **options)) from error
