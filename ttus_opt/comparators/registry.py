"""The comparators, discovered in this folder."""

from __future__ import annotations

import functools
import inspect
import sys
from typing import Any

from ttus_opt.comparators.base import Comparator
from ttus_opt.core import plugins
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.surface import Surface


@functools.cache
def _kinds() -> dict[str, type[Comparator]]:
    """Classes by the name they are made by."""
    classes = plugins.classes_of(sys.modules["ttus_opt.comparators"]).values()
    kinds = [kind for kind in classes if issubclass(kind, Comparator) and kind.name]
    return {kind.name: kind for kind in sorted(kinds, key=lambda kind: kind.name)}


def available() -> dict[str, str]:
    """Names of the comparators with their summaries."""
    return {name: kind.summary for name, kind in _kinds().items()}


def kind(name: str) -> type[Comparator]:
    """The class of a comparator.

    Raises:
        InputError: Unknown name.
    """
    kinds = _kinds()
    if name not in kinds:
        raise InputError(f"unknown comparator {name!r}: choose from {', '.join(kinds)}")
    return kinds[name]


def create(
    name: str,
    *,
    surface: Surface,
    shell: PointShell,
    cloud: Array | None = None,
    **options: Any,
) -> Comparator:
    """A comparator, not yet fitted.

    Args:
        name: One of `available`.
        surface: The patient.
        shell: The probe.
        cloud: Points of the surface, patient frame, for those that work on a cloud,
            shape (n, 3) [m]; by default the surface's nodes.
        options: Options of the comparator, see its class.

    Raises:
        InputError: Unknown name or option, or an invalid cloud.
    """
    made = kind(name)
    common = {"self", "given", "surface", "shell", "cloud"}
    known = set(inspect.signature(made.__init__).parameters) - common
    unknown = sorted(options.keys() - known)
    if unknown:
        raise InputError(
            f"{name} has no option {', '.join(unknown)}: it has "
            f"{', '.join(sorted(known)) or 'none'}"
        )
    return made(surface=surface, shell=shell, cloud=cloud, **options)
