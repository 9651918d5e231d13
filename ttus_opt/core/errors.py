"""The package's errors: one base, one class per kind of fault.

A message says what was given, what was expected and what to do about it, in one
line: the command line prints it as it is.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator


class TtusError(Exception):
    """Base of every error this package raises on purpose."""


class InputError(TtusError, ValueError):
    """A value, array or option that cannot be used."""


class FileError(TtusError, OSError):
    """A file is missing, truncated, of another format or of another version."""


class GeometryError(InputError):
    """Surfaces, grids or probes that are degenerate or do not fit together."""


class MissingPackageError(TtusError, ImportError):
    """A package that the call needs is not installed."""


class SolverUnavailableError(MissingPackageError):
    """The package of the requested solver is not installed."""


class TtusWarning(UserWarning):
    """Something the user should know, although the work goes on."""


class MistakeWarning(TtusWarning):
    """A likely mistake in what was given; an error with ``--strict``."""


class NumericalError(TtusError, ArithmeticError):
    """An iteration did not reach its tolerance; the message says how far it came."""


def warn(message: str, depth: int = 1, kind: type[TtusWarning] = TtusWarning) -> None:
    """Issue a warning that points ``depth`` calls above the calling function."""
    warnings.warn(message, kind, stacklevel=depth + 2)


def counted(n: int, noun: str) -> str:
    """A number and what it counts.

    >>> counted(1, "row"), counted(2000, "row")
    ('1 row', '2,000 rows')
    """
    return f"{n:,} {noun}{'s' * (n != 1)}"


@contextlib.contextmanager
def located(place: object, kind: type[TtusError] = InputError) -> Iterator[None]:
    """Prefix the message of an `InputError` with a place, and raise it as ``kind``."""
    try:
        yield
    except InputError as error:
        raise kind(f"{place}: {error}") from error
