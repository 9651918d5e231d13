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

#: Attributes of ``status``: meanings of the numbers, after the CF conventions
STATUS = {
    "units": "1",
    "flag_values": np.array([MISSING, *range(len(Status))], dtype=np.int8),
    "flag_meanings": " ".join(["missing", *(one.name.lower() for one in Status)]),
}

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
        import xarray as xr

        self._declared, self._grid = declared, grid
        self._inputs, self._tolerance = inputs, tolerance
        scene = declared.scene
        segment = scene.trajectory.segment
        self._recordings = {str(n): segment == n for n in np.unique(segment)}
        self._held_out = {
            name: (one, scene.rows_along(one)) for name, one in held_out.items()
        }
        self._solvers: list[str] = []
        self._data = xr.Dataset(coords=self._coordinates(keep_fields))
        square = "N2" if scene.sampling == "voxel-mean" else "N2 cm-4"
        status = np.full(grid.shape, MISSING, dtype=np.int8)
        self._data["status"] = (self._dims, status, STATUS)
        self._add(
            "kkt_residual", "1", "largest relative residual of the KKT conditions"
        )
        self._add("objective", square, "weighted sum of all terms")
        self._add("seconds", "s", "time this point took beyond those before it")
        meaning = (
            "penalty of the term's residual without its weight, in the square of the "
            "unit of its rows where it is a sum of squares"
        )
        self._add("term_value", "1", meaning, "term")
        if scene.trajectory.has_wrench:
            meaning = "root mean square of the residual's length over the frames"
            for name, unit in (("force_residual", "N"), ("torque_residual", "mN m")):
                self._add(name, unit, meaning, "recording")
        if held_out:
            for name, (unit, figure, _scale) in HELD_OUT.items():
                self._add(name, unit, f"{figure} of evaluate", "held_out")
        if keep_fields:
            self._add("potential", field_unit(scene.sampling), "", *DIMS)

    @property
    def _dims(self) -> tuple[str, ...]:
        return tuple(axis.dimension for axis in self._grid.axes)

    def _add(self, name: str, unit: str, meaning: str, *beyond: str) -> None:
        """A variable over the grid and further dimensions, NaN so far."""
        shape = (*self._grid.shape, *(self._data.sizes[dim] for dim in beyond))
        about = {"units": unit} | ({"long_name": meaning} if meaning else {})
        self._data[name] = ((*self._dims, *beyond), np.full(shape, np.nan), about)

    def _values(self, name: str) -> Array:
        """A variable's numbers; criteria and parameters are added as they come."""
        if name not in self._data:
            plain = PARAMETER_UNITS.get(name.removeprefix(PARAMETER), "1")
            self._add(name, *CRITERIA.get(name, (plain, "")))
        return self._data[name].values

    @property
    def done(self) -> int:
        """Number of points that were reached."""
        return int((self._values("status") != MISSING).sum())

    @property
    def size(self) -> int:
        """Number of all points."""
        return self._grid.size

    def has(self, at: Index) -> bool:
        """Whether a point was reached."""
        return bool(self._values("status")[at] != MISSING)

    def take(self, kept: xr.Dataset) -> None:
        """Take the points of a dataset of the same inputs."""
        self._solvers = [name for name in kept.attrs["solver"].split(", ") if name]
        for name, values in kept.data_vars.items():
            self._values(str(name))[...] = values

    def add(
        self, at: Index, solution: Solution, criteria: Mapping[str, float] | None = None
    ) -> None:
        """Record the solution and the criteria of one point."""
        self._note(at, solution, criteria or {})
        # last, so that an interrupt leaves no point done by half
        self._values("status")[at] = list(Status).index(solution.status)

    def _note(
        self, at: Index, solution: Solution, criteria: Mapping[str, float]
    ) -> None:
        """Record all but the status."""
        if solution.solver not in self._solvers:
            self._solvers.append(solution.solver)
        times = solution.timings
        taken = times.setup + times.solve if times.again is None else times.again
        self._values("seconds")[at] = taken + (times.search or 0.0)
        if solution.kkt is not None:
            self._values("kkt_residual")[at] = solution.kkt.worst_relative
        if solution.verified_field is None:
            return
        self._values("objective")[at] = solution.objective
        weights = {term.name: term.weight for term in solution.program.terms}
        for k, name in enumerate(self._data["term"].values.tolist()):
            if weights.get(name, 0.0) > 0.0:
                own = solution.costs[name] / weights[name]
                self._values("term_value")[(*at, k)] = own
        parameters = {f"{PARAMETER}{n}": v for n, v in solution.parameters.items()}
        for name, value in {**criteria, **parameters}.items():
            self._values(name)[at] = value
        self._judge(at, solution.verified_field)

    def _judge(self, at: Index, field: PotentialField) -> None:
        """Record a field's errors on the recordings."""
        scene = self._declared.scene
        if "potential" in self._data:
            self._values("potential")[at] = field.values
        measured = scene.trajectory
        if measured.force is not None:
            felt = wrenches_by_rows(scene.rows, field, scene.shell, measured)
            for k, part in enumerate(self._recordings.values()):
                off = _rms((felt.force - measured.force)[part])
                self._values("force_residual")[(*at, k)] = off
                if measured.torque is not None:
                    off = 1e3 * _rms(felt.torque[part] - measured.torque[part])
                    self._values("torque_residual")[(*at, k)] = off
        for k, (one, rows) in enumerate(self._held_out.values()):
            felt = wrenches_by_rows(rows, field, scene.shell, one)
            errors: Errors = compare(one, felt).errors
            for name, (_unit, figure, scale) in HELD_OUT.items():
                self._values(name)[(*at, k)] = scale * getattr(errors, figure)

    def dataset(self) -> xr.Dataset:
        """The recorded points; NaN and status -1 elsewhere."""
        return self._data.assign_attrs(self._attributes())

    def _coordinates(self, keep_fields: bool) -> dict[str, object]:
        coords: dict[str, object] = {}
        for axis in self._grid.axes:
            for name in axis.terms:
                about = {"units": "1", "long_name": f"weight of term {name}"}
                coords[f"{name}_weight"] = (axis.dimension, axis.values, about)
        names = {"term": [term.name for term in self._declared.terms]}
        if self._declared.scene.trajectory.has_wrench:
            names["recording"] = list(self._recordings)
        if self._held_out:
            names["held_out"] = list(self._held_out)
        for name, values in names.items():
            coords[name] = (name, np.array(values, dtype=str), {"units": "1"})
        if keep_fields:
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
    import xarray as xr

    found = io.read_content(path, kind=KIND, version=VERSION)
    if not {"status", "objective", "term_value"} <= set(found.variables):
        raise FileError(f"{path}: damaged solution path: write it again")
    given = {n: (v.dims, v.values, v.attrs) for n, v in found.variables.items()}
    return xr.decode_cf(xr.Dataset(given, attrs=found.attrs))


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


def _rms(vectors: Array) -> float:
    """Root mean square of the lengths of vectors, shape (T, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
