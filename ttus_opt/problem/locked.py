"""A program whose arrays cannot be written to while a user's code has it.

A program's matrices are those of the scene, and of the verdict after the solve: a
solver that scales them in place would change both.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array


@contextlib.contextmanager
def locked(thing: Any) -> Iterator[None]:
    """Make all arrays of a dataclass, in members too, read-only within the block."""
    arrays: dict[int, Array] = {}
    _collect(thing, arrays, set())
    written = [array for array in arrays.values() if array.flags.writeable]
    try:
        for array in written:
            array.flags.writeable = False
        yield
    finally:
        for array in reversed(written):
            array.flags.writeable = True


def _collect(thing: Any, arrays: dict[int, Array], seen: set[int]) -> None:
    """Arrays of a thing, of its fields and of what it has cached."""
    if isinstance(thing, np.ndarray):
        arrays[id(thing)] = thing
    elif sp.issparse(thing):
        parts: list[Any] = [vars(thing).get(k) for k in ("data", "indices", "indptr")]
        for part in (*parts, *(vars(thing).get("coords") or ())):
            _collect(part, arrays, seen)
    elif id(thing) not in seen:
        seen.add(id(thing))
        if dataclasses.is_dataclass(thing):
            thing = tuple(vars(thing).values())
        elif isinstance(thing, Mapping):
            thing = tuple(thing.values())
        if isinstance(thing, tuple | list | frozenset):
            for part in thing:
                _collect(part, arrays, seen)
