"""The file of a path: what it holds already, and what is added as points are done.

Checksums of all that determines a path tell whether a file goes on.
"""

from __future__ import annotations

import enum
import hashlib
import json
import os
import time
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, warn
from ttus_opt.fitting.path.path_dataset import (
    INPUTS,
    PathRecord,
    read_solution_path,
    write_solution_path,
)
from ttus_opt.fitting.path.weight_grid import WeightGrid
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.formulation import Formulation
from ttus_opt.solvers.base import Solver

if TYPE_CHECKING:
    import xarray as xr

#: Least time between two writes before the path is complete [s]
SAVE_EVERY = 30.0


#: Digits of a checksum
DIGITS = 16
#: Resolution of computed numbers, relative to the largest of an array [–]
ROUNDING = 1e-6


class PathFile:
    """Keeps the points of a path in a file, so that another call goes on from them.

    Args:
        file: The file, which need not exist.
        record: The points, of which those in the file are taken at once.
        inputs: Checksums of the path's inputs.

    Raises:
        FileError: The file cannot be written.
    """

    def __init__(
        self,
        file: str | os.PathLike[str],
        record: PathRecord,
        inputs: Mapping[str, str],
    ) -> None:
        io.check_output(file)
        self._file, self._record = file, record
        kept = _kept(file, inputs)
        if kept is not None:
            record.take(kept)
        self._saved_points, self._saved_at = record.done, time.monotonic()

    def __str__(self) -> str:
        return str(self._file)

    def save_now_and_then(self) -> None:
        """Write the points, unless that was done a moment ago."""
        if time.monotonic() - self._saved_at > SAVE_EVERY:
            self.save()

    def save(self) -> None:
        """Write the points, if there are new ones."""
        if self._record.done > self._saved_points:
            write_solution_path(self._record.dataset(), self._file)
            self._saved_points = self._record.done
        self._saved_at = time.monotonic()


def _kept(file: str | os.PathLike[str], inputs: Mapping[str, str]) -> xr.Dataset | None:
    """The path in a file; None, with a warning, where it cannot be continued."""
    if not Path(file).exists():
        return None
    try:
        saved = read_solution_path(file)
        stated = json.loads(saved.attrs.get(INPUTS, "{}"))
    except (FileError, ValueError) as error:
        warn(f"all points are computed, and the file is replaced: {error}", 3)
        return None
    other = [name for name in inputs if stated.get(name) != inputs[name]]
    if "scene" in other and "formulation" in other:
        other.remove("formulation")  # its rows are those of the scene
    if not other:
        return saved
    what = f"other inputs ({', '.join(other)})" if stated else "unknown inputs"
    warn(
        f"{file} holds a path of {what}: all points are computed, and the file is "
        "replaced",
        3,
    )
    return None


def inputs_of(
    first: Formulation,
    grid: WeightGrid,
    held_out: Mapping[str, Trajectory],
    solver: str | Path | Solver,
    tolerance: float,
    extras: Collection[str],
) -> dict[str, str]:
    """Checksums of a path's inputs, by what a message calls them.

    Args:
        first: The formulation with the weights of the first point.
        grid: All weights.
        held_out: Recordings by name.
        solver: As in `ttus_opt.fit`.
        tolerance: KKT tolerance [–].
        extras: Optional contents.
    """
    scene = first.scene
    patient = (
        scene.voxmap,
        scene.shell,
        scene.trajectory,
        scene.sampling,
        _Rounded(scene.b),
    )
    given: dict[str, Any] = {
        "scene": patient,
        "formulation": _Rounded(list(_programs(first))),
        "weights": grid,
        "held-out recordings": held_out,
        "solver": _text_of(solver),
        "tolerance": float(tolerance),
        "extras": sorted(extras),
        "version": io.provenance()["source"],
    }
    return {name: _checksum(value) for name, value in given.items()}


def _programs(declared: Formulation) -> Iterator[Any]:
    """The matrices; of a search at both ends of its range, which its rows depend on."""
    search = declared.search
    if search is None:
        program = declared.compile()
        terms = [
            (t.name, t.weight, t.matrix, t.target, t.penalty) for t in program.terms
        ]
        rows = [(c.name, c.matrix, c.lower, c.upper) for c in program.constraints]
        yield declared.name, program.variables, terms, rows
        yield program.bounds, program.cones
        return
    yield search.parameter, search.neutral
    for value in (search.low, search.high):
        yield from _programs(search.build(value))


def _text_of(solver: str | Path | Solver) -> str:
    """A solver's name, or the text of its file."""
    if isinstance(solver, str | Path):
        file = Path(solver)
        return file.read_text() if file.suffix == ".py" else str(solver)
    return f"{type(solver).__module__}.{type(solver).__qualname__} {solver.name}"


@dataclass(frozen=True)
class _Rounded:
    """Computed numbers, whose last digits differ with the number of threads."""

    value: Any


def _checksum(value: Any) -> str:
    digest = hashlib.sha256()
    for part in _content(value):
        digest.update(part)
    return digest.hexdigest()[:DIGITS]


def _content(value: Any, rounded: bool = False) -> Iterator[bytes]:
    """Bytes that identify a value by its content, the same in every process."""
    if isinstance(value, _Rounded):
        yield from _content(value.value, rounded=True)
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype} {value.shape}".encode()
        if rounded and value.dtype.kind == "f":
            value = _coarse(value)
        yield np.ascontiguousarray(value).tobytes()
    elif hasattr(value, "tocsr"):
        rows = value.tocsr()
        parts = (rows.shape, rows.indptr, rows.indices, rows.data)
        yield from _content(parts, rounded)
    elif isinstance(value, Mapping):
        yield from _content(list(value.items()), rounded)
    elif isinstance(value, tuple | list):
        yield f"{len(value)} parts".encode()
        for part in value:
            yield from _content(part, rounded)
    elif is_dataclass(value):
        yield type(value).__qualname__.encode()
        pairs = [(one.name, getattr(value, one.name)) for one in fields(value)]
        yield from _content(pairs, rounded)
    elif hasattr(value, "__dict__") and not isinstance(value, enum.Enum):
        yield type(value).__qualname__.encode()  # a user's own class
        yield from _content(vars(value), rounded)
    else:
        few = rounded and isinstance(value, float)
        yield (f"{value:.9g}" if few else repr(value)).encode()


def _coarse(values: Array) -> Array:
    """Multiples of a millionth of the largest finite value, which comes last."""
    largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    if largest == 0.0:
        return values
    multiples = np.rint(values / (ROUNDING * largest)) + 0.0  # no negative zero
    return np.append(multiples, float(f"{largest:.9g}"))
