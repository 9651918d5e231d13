"""The fitted potential field: values on a voxmap, and its netCDF file.

The file holds all that rendering needs (grid, surface, regions, sampling) and the
field's provenance.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.arguments import expect_shape, hold_numbers
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.core.html_card import SIZE, card, signed_map
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.grid import CylindricalGrid
from ttus_opt.voxmap.sampling import check_sampling, field_unit
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap
from ttus_opt.voxmap.voxmap import Voxmap

if TYPE_CHECKING:
    import xarray as xr

    from ttus_opt.viewer.viewer import Viewer


KIND, VERSION = "field", 1

#: Dimensions of voxel values and of the surface in the file
DIMS, ON_SURFACE = ("r", "theta", "z"), ("surface_theta", "surface_z")

#: Largest potential of a file [N, or N/cm²]: a hundred megapascals
LARGEST = 1e4

#: Variable with draws from the field's posterior, read on request only
DRAWS = "uncertainty_draws"


@dataclass(frozen=True, eq=False)
class PotentialField:
    """A potential field p, positive inside the patient.

    Attributes:
        voxmap: Grid, surface and regions.
        values: p per voxel, shape ``grid.shape`` [N when voxel-mean, else N/cm²].
        sampling: How contact samples it: ``voxel-mean``, ``trilinear`` or
            ``contact-size`` (`voxmap.sampling`).
        parameters: Parameters identified with the field, by name (boundary_scale).
        provenance: Free text by key: formulation, solver, trajectory, …
        standard_errors: Standard errors of the parameters, by name, where known.
        uncertainty: Relative uncertainty of presses; None where unknown.
    """

    voxmap: Voxmap
    values: Array = field(repr=False)
    sampling: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, str] = field(default_factory=dict, repr=False)
    standard_errors: Mapping[str, float] = field(default_factory=dict, repr=False)
    uncertainty: UncertaintyMap | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Validate shape, sampling, and that values and parameters are finite."""
        hold_numbers(self, "field", "values")
        expect_shape(self.values, self.voxmap.grid.shape, "field values")
        if not np.isfinite(self.values).all():
            raise InputError("field values contain NaN or infinity: the fit failed")
        check_sampling(self.sampling)
        for name, value in self.parameters.items():
            if not (isinstance(value, int | float) and math.isfinite(value)):
                raise InputError(
                    f"parameter {name} must be a finite number, got {value}"
                )

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return field_unit(self.sampling)

    def differs_in(self, other: PotentialField) -> str:
        """The first of grid, surface, sampling that is another's own; "" if none."""
        one, another = self.voxmap.surface, other.voxmap.surface
        alike = {
            "grid": self.voxmap.grid == other.voxmap.grid,
            "surface": one is another or np.array_equal(one.radius, another.radius),
            "sampling": self.sampling == other.sampling,
        }
        return next((name for name, same in alike.items() if not same), "")

    def __repr__(self) -> str:
        return f"PotentialField({', '.join(self._facts().values())})"

    def _repr_html_(self) -> str:
        return card("PotentialField", self._facts(), signed_map(self._section()))

    def view(self, *shown: Any, **options: Any) -> Viewer:
        """Open a page that shows the field; arguments as of `ttus_opt.view`.

        In a notebook the page is the cell's output.
        """
        import ttus_opt

        return ttus_opt.view(self, *shown, **options)

    def _section(self) -> Array:
        """P at mid-height seen along z, y upwards; zero outside the grid, (n, n)."""
        grid = self.voxmap.grid
        across = np.linspace(-grid.r_outer, grid.r_outer, SIZE // 2)
        x, y = across[None, :], across[::-1, None]
        layer = np.rint((np.hypot(x, y) - grid.r_inner) / grid.r_step).astype(int)
        n_r, n_theta, n_z = grid.shape
        angle = np.arctan2(y, x)
        face = grid.theta[0] - 0.5 * grid.theta_step
        turned = ((angle - face) % TURN / grid.theta_step).astype(int)
        spoke = np.minimum(turned, n_theta - 1)  # beside a sector any one
        inside = (layer >= 0) & (layer < n_r) & grid.in_sector(angle)
        values = self.values[np.clip(layer, 0, n_r - 1), spoke, n_z // 2]
        return np.where(inside, values, 0.0)

    def _facts(self) -> dict[str, str]:
        """A short description, by name."""
        low, high = self.values.min(), self.values.max()
        unit = "N" if self.sampling == "voxel-mean" else "N/cm²"
        facts = {
            "voxels": self.voxmap.grid.sizes,
            "potential": f"p {low:.3g} to {high:.3g} {unit}",
            "sampling": self.sampling,
        }
        for name, value in self.parameters.items():
            error = self.standard_errors.get(name)
            uncertainty = "" if error is None else f" ± {error:.2g}"
            facts[name] = f"{name} {value:.4g}{uncertainty}"
        return facts

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the field as netCDF, replacing ``path`` only on success."""
        io.write_dataset(self.to_xarray(), path, kind=KIND, version=VERSION)

    def to_xarray(self) -> xr.Dataset:
        """The field with its grid and surface, as `save` writes it.

        Returns:
            ``potential`` and ``region`` over (r, theta, z) and the surface over
            (surface_theta, surface_z), with units and coordinates on every variable;
            ``uncertainty`` over (uncertainty_theta, uncertainty_z) where known; the
            rest as attributes. For a sector the attribute ``sector`` holds its two
            angles [rad], and the last spoke is the wall beyond it, without a field.
        """
        import xarray as xr

        grid, surface = self.voxmap.grid, self.voxmap.surface
        sector = {} if grid.sector is None else {"sector": json.dumps([*grid.sector])}
        return xr.Dataset(
            {
                "potential": (DIMS, self.values, {"units": self.unit}),
                "region": (
                    DIMS,
                    self.voxmap.region,
                    {"units": "1", "flags": "1 inside, 0 surface, -1 outside"},
                ),
                "radius": (ON_SURFACE, surface.radius, {"units": "m"}),
                "radius_std": (ON_SURFACE, surface.radius_std, {"units": "m"}),
                "observed": (ON_SURFACE, surface.observed.astype("i1"), {"units": "1"}),
                **({} if self.uncertainty is None else self.uncertainty.variables()),
            },
            coords={
                "r": ("r", grid.r, {"units": "m"}),
                "theta": ("theta", grid.theta, {"units": "rad"}),
                "z": ("z", grid.z, {"units": "m"}),
                "surface_theta": ("surface_theta", surface.theta, {"units": "rad"}),
                "surface_z": ("surface_z", surface.z, {"units": "m"}),
            },
            attrs={
                "sampling": self.sampling,
                "boundary": self.voxmap.boundary,
                "grid_limits": json.dumps(
                    [grid.r_inner, grid.r_outer, grid.z_min, grid.z_max]
                ),
                "parameters": json.dumps(dict(self.parameters)),
                "provenance": json.dumps(dict(self.provenance)),
                "standard_errors": json.dumps(dict(self.standard_errors)),
                **sector,
                **surface.axis.attributes(),
            },
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> PotentialField:
        """Read a field file.

        Raises:
            FileError: Not a field file, another version, or damaged.
        """
        data = io.read_content(path, kind=KIND, version=VERSION, without=(DRAWS,))
        try:
            return _from_content(data)
        except (KeyError, InputError, TypeError, ValueError) as error:
            raise FileError(f"{path}: damaged field file: {error}") from error


def _from_content(data: io.Content) -> PotentialField:
    """The field that `PotentialField.save` wrote.

    Raises:
        InputError: A variable is missing, has other dimensions or units, or does not
            match the grid; also KeyError, TypeError or ValueError.
    """
    sampling = io.text_of(data.attrs, "sampling")
    check_sampling(sampling)
    values = io.array_of(data, "potential", DIMS, field_unit(sampling))
    most = float(np.abs(values).max(initial=0.0))
    if most > LARGEST:
        raise InputError(
            f"potential reaches {most:.3g} {field_unit(sampling)}, tissue bears no "
            f"more than {LARGEST:g}: damaged, or in another unit"
        )
    r_inner, r_outer, z_min, z_max = json.loads(io.text_of(data.attrs, "grid_limits"))
    sector = json.loads(io.text_of(data.attrs, "sector", "null"))
    grid = CylindricalGrid(
        r_inner, r_outer, z_min, z_max, values.shape, sector and tuple(sector)
    )
    for name, units in zip(DIMS, ("m", "rad", "m"), strict=True):
        centres = io.array_of(data, name, (name,), units)
        if not np.allclose(centres, getattr(grid, name), rtol=0.0, atol=1e-9):
            raise InputError(f"{name} is not where grid_limits puts the voxels")
    surface = Surface(
        io.array_of(data, "surface_theta", ON_SURFACE[:1], "rad"),
        io.array_of(data, "surface_z", ON_SURFACE[1:], "m"),
        io.array_of(data, "radius", ON_SURFACE, "m"),
        io.array_of(data, "radius_std", ON_SURFACE, "m"),
        io.mask("observed", io.array_of(data, "observed", ON_SURFACE, "1")),
        Axis.from_attributes(data.attrs),
    )
    region = io.array_of(data, "region", DIMS, "1")
    # older files have no boundary
    boundary = io.text_of(data.attrs, "boundary", "staircase")
    return PotentialField(
        Voxmap(grid, surface, region, boundary),
        values,
        sampling,
        _by_name("parameters", data.attrs),
        _by_name("provenance", data.attrs),
        _by_name("standard_errors", data.attrs),
        UncertaintyMap.of_file(data),
    )


def _by_name(attribute: str, attributes: Mapping[str, Any]) -> dict[str, Any]:
    """An attribute that is a JSON object; empty where it is absent."""
    text = io.text_of(attributes, attribute, "{}")
    values = json.loads(text)
    if not isinstance(values, dict):
        raise InputError(
            f"attribute {attribute} must be a JSON object, got {io.shortened(text)}"
        )
    return values
