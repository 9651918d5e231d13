"""The package's errors: one base, one class per kind of fault.

A message says what was given, what was expected and what to do about it, in one
line: the command line prints it as it is.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator


class TtusError(Exception):
    """Base of every error this package raises on purpose."""


class InputError(TtusError, ValueError):
    """A value, array or option handed to the package is not usable."""


class FileError(TtusError, OSError):
    """A file is missing, truncated, of another format or of another version."""


class GeometryError(InputError):
    """Surfaces, grids or probes that do not fit together or are degenerate."""


class MissingPackageError(TtusError, ImportError):
    """Work was asked for whose package is not installed."""


class SolverUnavailableError(MissingPackageError):
    """A solver was asked for whose package is not installed."""


class TtusWarning(UserWarning):
    """Something the user should know although the work goes on."""


class NumericalError(TtusError, ArithmeticError):
    """An iteration did not reach its tolerance; the message says how far it came."""


@contextlib.contextmanager
def located(place: object, kind: type[TtusError] = InputError) -> Iterator[None]:
    """Put where it is before what an `InputError` says.

    Args:
        place: Such as a file.
        kind: The error's class from here on.
    """
    try:
        yield
    except InputError as error:
        raise kind(f"{place}: {error}") from error
