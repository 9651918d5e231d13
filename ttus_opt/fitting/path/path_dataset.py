"""A path of weights as an xarray Dataset, and its netCDF file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError
from ttus_opt.fitting.path.weight_grid import Index, WeightGrid
from ttus_opt.fitting.weights.place_left_out import CRITERIA
from ttus_opt.haptic.field_wrench import wrenches_by_rows
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.solution import Solution, Status
from ttus_opt.report.metrics import Errors, compare
from ttus_opt.voxmap.field import DIMS, PotentialField
from ttus_opt.voxmap.sampling import field_unit

if TYPE_CHECKING:
    import xarray as xr

KIND, VERSION = "solution path", 1

#: Attribute with the checksums of a path's inputs, as JSON
INPUTS = "inputs"

#: Value of ``status`` where a point was not reached
MISSING = -1

#: What the names of variables of parameters begin with
PARAMETER = "parameter_"

#: Units of parameters that have one
PARAMETER_UNITS = {
    "viscous_coefficient": "N s m-1",
    "drag_deadband": "m s-1",
    "presliding_length": "m",
}

#: Variables per held-out recording: unit, field of `Errors`, and its factor
HELD_OUT = {
    "held_out_force_magnitude_error": ("N", "force_magnitude_error_N", 1.0),
    "held_out_force_angle_error": ("degree", "force_angle_error_deg", 1.0),
    "held_out_torque_magnitude_error": ("mN m", "torque_magnitude_error_Nm", 1e3),
    "held_out_torque_angle_error": ("degree", "torque_angle_error_deg", 1.0),
}


class PathRecord:
    """Collects the points of a path.

    Args:
        declared: The formulation.
        grid: Its weights.
        held_out: Recordings by name, on which every point is evaluated.
        tolerance: KKT tolerance of every point [–].
        keep_fields: Whether potentials are kept.
        inputs: Checksums of the path's inputs (`path_file`); none by default.
    """

    def __init__(
        self,
        declared: Formulation,
        grid: WeightGrid,
        held_out: Mapping[str, Trajectory],
        tolerance: float,
        *,
        keep_fields: bool = False,
        inputs: Mapping[str, str] | None = None,
    ) -> None:
        self._declared, self._grid = declared, grid
        self._inputs = inputs
        self._tolerance = tolerance
        scene = declared.scene
        self._terms = [term.name for term in declared.terms]
        self._recordings = _segments(scene.trajectory)
        self._held_out = {
            name: (one, scene.rows_along(one)) for name, one in held_out.items()
        }
        self._status = np.full(grid.shape, MISSING, dtype=np.int8)
        self._numbers: dict[str, Array] = {
            name: self._empty() for name in ("kkt_residual", "objective", "seconds")
        }
        self._values = self._empty(len(self._terms))
        self._residuals = {
            name: self._empty(len(self._recordings))
            for name in ("force_residual", "torque_residual")
        }
        self._errors = {name: self._empty(len(held_out)) for name in HELD_OUT}
        self._criteria: dict[str, Array] = {}
        self._parameters: dict[str, Array] = {}
        shape = scene.voxmap.grid.shape
        self._potential = self._empty(*shape) if keep_fields else None
        self._solvers: list[str] = []

    def _empty(self, *beyond: int) -> Array:
        return np.full((*self._grid.shape, *beyond), np.nan)

    @property
    def done(self) -> int:
        """Number of points that were reached."""
        return int((self._status != MISSING).sum())

    @property
    def size(self) -> int:
        """Number of all points."""
        return self._grid.size

    def has(self, at: Index) -> bool:
        """Whether a point was reached."""
        return bool(self._status[at] != MISSING)

    def take(self, kept: xr.Dataset) -> None:
        """Take the points of a dataset of the same inputs."""
        self._status[...] = kept["status"]
        self._solvers = [name for name in kept.attrs["solver"].split(", ") if name]
        for group in (self._numbers, self._residuals, self._errors):
            for name in set(group) & set(kept):
                group[name][...] = kept[name]
        self._values[...] = kept["term_value"]
        for name in map(str, kept):
            if name in CRITERIA:
                self._criteria[name] = kept[name].to_numpy().copy()
            elif name.startswith(PARAMETER):
                values = kept[name].to_numpy().copy()
                self._parameters[name.removeprefix(PARAMETER)] = values
        if self._potential is not None:
            self._potential[...] = kept["potential"]

    def add(
        self, at: Index, solution: Solution, criteria: Mapping[str, float] | None = None
    ) -> None:
        """Record the solution and the criteria of one point."""
        self._note(at, solution, criteria or {})
        # last, so that an interrupt leaves no point done by half
        self._status[at] = list(Status).index(solution.status)

    def _note(
        self, at: Index, solution: Solution, criteria: Mapping[str, float]
    ) -> None:
        """Record all but the status."""
        if solution.solver not in self._solvers:
            self._solvers.append(solution.solver)
        times = solution.timings
        taken = times.setup + times.solve if times.again is None else times.again
        self._numbers["seconds"][at] = taken + (times.search or 0.0)
        if solution.kkt is not None:
            self._numbers["kkt_residual"][at] = solution.kkt.worst_relative
        if solution.verified_field is None:
            return
        self._numbers["objective"][at] = solution.objective
        weights = {term.name: term.weight for term in solution.program.terms}
        for k, name in enumerate(self._terms):
            if weights.get(name, 0.0) > 0.0:
                self._values[(*at, k)] = solution.costs[name] / weights[name]
        for name, value in criteria.items():
            self._criteria.setdefault(name, self._empty())[at] = value
        for name, value in solution.parameters.items():
            self._parameters.setdefault(name, self._empty())[at] = value
        self._judge(at, solution.verified_field)

    def _judge(self, at: Index, field: PotentialField) -> None:
        """Record a field's errors on the recordings."""
        scene = self._declared.scene
        if self._potential is not None:
            self._potential[at] = field.values
        measured = scene.trajectory
        if measured.force is not None:
            felt = wrenches_by_rows(scene.rows, field, scene.shell, measured)
            force, torque = self._residuals.values()
            for k, part in enumerate(self._recordings.values()):
                force[(*at, k)] = _rms((felt.force - measured.force)[part])
                if measured.torque is not None:
                    off = felt.torque[part] - measured.torque[part]
                    torque[(*at, k)] = 1e3 * _rms(off)
        for k, (one, rows) in enumerate(self._held_out.values()):
            felt = wrenches_by_rows(rows, field, scene.shell, one)
            errors: Errors = compare(one, felt).errors
            for name, (_unit, figure, scale) in HELD_OUT.items():
                self._errors[name][(*at, k)] = scale * getattr(errors, figure)

    def dataset(self) -> xr.Dataset:
        """The recorded points; NaN and status -1 elsewhere."""
        import xarray as xr

        scene = self._declared.scene
        dims = tuple(axis.dimension for axis in self._grid.axes)
        potential_unit = field_unit(scene.sampling)
        square = "N2" if scene.sampling == "voxel-mean" else "N2 cm-4"
        numbers = {
            "kkt_residual": ("1", "largest relative residual of the KKT conditions"),
            "objective": (square, "weighted sum of all terms"),
            "seconds": ("s", "time this point took beyond those before it"),
        }
        out = xr.Dataset(coords=self._coordinates(), attrs=self._attributes())
        out["status"] = (dims, self._status, _status_attributes())

        def put(name: str, values: Array, unit: str, meaning: str, *more: str) -> None:
            about = {"units": unit, "long_name": meaning}
            out[name] = ((*dims, *more), values, about)

        for name, (unit, meaning) in numbers.items():
            put(name, self._numbers[name], unit, meaning)
        meaning = (
            "penalty of the term's residual without its weight, in the square of the "
            "unit of its rows where it is a sum of squares"
        )
        put("term_value", self._values, "1", meaning, "term")
        if scene.trajectory.has_wrench:
            meaning = "root mean square of the residual's length over the frames"
            for name, unit in (("force_residual", "N"), ("torque_residual", "mN m")):
                put(name, self._residuals[name], unit, meaning, "recording")
        if self._held_out:
            for name, (unit, figure, _scale) in HELD_OUT.items():
                meaning = f"{figure} of evaluate"
                put(name, self._errors[name], unit, meaning, "held_out")
        for name, values in self._criteria.items():
            put(name, values, *CRITERIA[name])
        for name, values in self._parameters.items():
            about = {"units": PARAMETER_UNITS.get(name, "1")}
            out[f"{PARAMETER}{name}"] = (dims, values, about)
        if self._potential is not None:
            about = {"units": potential_unit}
            out["potential"] = ((*dims, *DIMS), self._potential, about)
        return out

    def _coordinates(self) -> dict[str, object]:
        coords: dict[str, object] = {}
        for axis in self._grid.axes:
            for name in axis.terms:
                about = {"units": "1", "long_name": f"weight of term {name}"}
                coords[f"{name}_weight"] = (axis.dimension, axis.values, about)
        names = {"term": self._terms}
        if self._declared.scene.trajectory.has_wrench:
            names["recording"] = list(self._recordings)
        if self._held_out:
            names["held_out"] = list(self._held_out)
        for name, values in names.items():
            coords[name] = (name, np.array(values, dtype=str), {"units": "1"})
        if self._potential is not None:
            grid = self._declared.scene.voxmap.grid
            for name, unit in zip(DIMS, ("m", "rad", "m"), strict=True):
                coords[name] = (name, getattr(grid, name), {"units": unit})
        return coords

    def _attributes(self) -> dict[str, str | float | int]:
        scene = self._declared.scene
        return {
            "title": f"solution path of {self._declared.name}",
            "formulation": repr(self._declared),
            "solver": ", ".join(self._solvers),
            "tolerance": self._tolerance,
            "scene": repr(scene),
            "sampling": scene.sampling,
            "points": self._grid.size,
            "points_done": self.done,
            **({INPUTS: json.dumps(self._inputs)} if self._inputs else {}),
            **io.provenance(),
        }


def write_solution_path(dataset: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a path as netCDF, replacing ``path`` only on success.

    Raises:
        FileError: The file cannot be written.
    """
    io.write_dataset(dataset, path, kind=KIND, version=VERSION)


def read_solution_path(path: str | os.PathLike[str]) -> xr.Dataset:
    """Read a file of `write_solution_path`.

    Raises:
        FileError: Not such a file, another version, or damaged.
    """
    found = io.read_dataset(path, kind=KIND, version=VERSION)
    if not {"status", "objective", "term_value"} <= set(found.variables):
        raise FileError(f"{path}: damaged solution path: write it again")
    return found


def best_weights(dataset: xr.Dataset) -> dict[str, float]:
    """Weights of the point with the smallest mean held-out error of the force, by term.

    Empty where nothing was held out or nothing was solved.
    """
    if "held_out_force_magnitude_error" not in dataset:
        return {}
    error = dataset["held_out_force_magnitude_error"].mean("held_out")
    if bool(error.isnull().all()):
        return {}
    best = dataset.isel(error.argmin(...))
    names = [name for name in best.coords if str(name).endswith("_weight")]
    return {
        str(name).removesuffix("_weight"): float(best.coords[name]) for name in names
    }


def _status_attributes() -> dict[str, object]:
    """Meanings of the numbers, after the CF conventions."""
    values = [MISSING, *range(len(Status))]
    names = ["missing", *(status.name.lower() for status in Status)]
    return {
        "units": "1",
        "flag_values": np.array(values, dtype=np.int8),
        "flag_meanings": " ".join(names),
    }


def _segments(trajectory: Trajectory) -> dict[str, Array]:
    """Masks of the frames of every recording, by number."""
    numbers = np.unique(trajectory.segment)
    return {str(n): trajectory.segment == n for n in numbers}


def _rms(vectors: Array) -> float:
    """Root mean square of the lengths of vectors, shape (T, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
