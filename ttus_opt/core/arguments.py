"""Types of arguments, checked where a mix-up would otherwise surface far inside."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.core.io import shortened


def expect(value: object, kind: type, name: str) -> None:
    """Refuse an argument of another type.

    Args:
        value: What was given.
        kind: The type it must have.
        name: Of the argument.

    Raises:
        InputError: It has another type.
    """
    if isinstance(value, kind):
        return
    given = type(value)
    hint = ": pass its .field" if hasattr(given, "field") else ""
    raise InputError(f"{name} must be a {kind.__name__}, got a {given.__name__}{hint}")


def expect_positive(value: float, name: str, unit: str = "") -> None:
    """Refuse a number that is not positive and finite.

    >>> expect_positive(0.0, "depth", "m")
    Traceback (most recent call last):
    ttus_opt.core.errors.InputError: depth must be positive [m], got 0.0
    """
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} must be positive{_of(unit)}, got {value}")


def expect_not_negative(value: float, name: str, unit: str = "") -> None:
    """Refuse a number that is negative or not finite; arguments as above."""
    if not (math.isfinite(value) and value >= 0.0):
        raise InputError(f"{name} must not be negative{_of(unit)}, got {value}")


def expect_between(
    value: float, low: float, high: float, name: str, unit: str = ""
) -> None:
    """Refuse a number outside a range."""
    if not low <= value <= high:
        limits = f"{low:g} and {high:g} {unit}".rstrip()
        raise InputError(f"{name} must lie between {limits}, got {value}")


def expect_one_of(value: object, known: Iterable[str], name: str) -> None:
    """Refuse a word that is not known.

    >>> expect_one_of("inch", ("m", "mm"), "unit")
    Traceback (most recent call last):
    ttus_opt.core.errors.InputError: unit must be one of m, mm, got 'inch'
    """
    if value not in (words := list(known)):
        given = shortened(value)
        raise InputError(f"{name} must be one of {', '.join(words)}, got {given}")


def expect_whole(value: float, least: int, most: int, name: str) -> None:
    """Refuse a count with a fraction or outside a range."""
    if int(value) != value or not least <= value <= most:
        raise InputError(
            f"{name} must be a whole number of at least {least}, at most {most:,}, got "
            f"{shortened(value)}"
        )


def expect_shape(array: np.ndarray, shape: tuple[int, ...], name: str) -> None:
    """Refuse an array of another shape."""
    if array.shape != shape:
        raise InputError(f"{name} must have shape {shape}, got {array.shape}")


def _of(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def chosen(
    names: Iterable[str], known: Iterable[str], what: str, every: str = "all"
) -> tuple[str, ...]:
    """Names that are known, each once.

    Args:
        names: As given.
        known: All there are.
        what: They are names of, for the message.
        every: Stands for all; "" where no word does.

    Raises:
        InputError: An unknown name.

    >>> chosen(["b", "b"], "abc", "letter"), chosen(["b", "all"], "abc", "letter")
    (('b',), ('a', 'b', 'c'))
    """
    there, asked = tuple(known), tuple(dict.fromkeys(names))
    for name in asked:
        if name not in there and not (every and name == every):
            rest = f", or {every}" if every else ""
            raise InputError(
                f"unknown {what} {name!r}: choose from {', '.join(there)}{rest}"
            )
    return there if every in asked else asked


def hold_numbers(owner: object, kind: str, *names: str) -> None:
    """Replace arrays of a frozen dataclass by those of `numbers`; kind for errors."""
    for name in names:
        held = numbers(getattr(owner, name), f"{kind} {name}")
        object.__setattr__(owner, name, held)


def numbers(value: object, name: str, hint: str = "") -> Array:
    """An array of real numbers as compiled code reads it: float64, C order.

    The array itself where it is one already.

    Args:
        value: What was given.
        name: Of the array.
        hint: What to do, at the end of the message.

    Raises:
        InputError: It is no array, such as a list, or one of objects, text or complex
            numbers.
    """
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        return np.ascontiguousarray(value, dtype=np.float64)
    given = type(value).__name__
    if isinstance(value, np.ndarray):
        given = f"an array of {value.dtype}"
    raise InputError(f"{name} must be an array of real numbers, got {given}{hint}")
