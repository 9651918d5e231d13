import re

import netCDF4
import numpy as np
import pytest
import xarray as xr

from tests.hostile import NUMBERS, only_our_errors
from tests.kit import FileError, InputError, TtusWarning, refuses, torso
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap


@pytest.fixture
def field():
    voxmap = Voxmap.from_surface(torso(), shape=(8, 12, 6))
    values = np.random.default_rng(0).normal(size=(8, 12, 6))
    return PotentialField(
        voxmap, values, "trilinear", {"boundary_scale": 2.5}, {"solver": "none"}
    )


def test_round_trip(field, tmp_path):
    field.save(tmp_path / "a.nc")
    back = PotentialField.load(tmp_path / "a.nc")
    np.testing.assert_array_equal(back.values, field.values)
    np.testing.assert_array_equal(back.voxmap.region, field.voxmap.region)
    np.testing.assert_array_equal(
        back.voxmap.surface.radius, field.voxmap.surface.radius
    )
    assert back.voxmap.grid == field.voxmap.grid
    assert back.sampling == "trilinear"
    assert back.parameters == {"boundary_scale": 2.5}
    assert back.provenance == {"solver": "none"}


def test_the_boundary_is_kept_and_old_files_are_staircases(field, tmp_path):
    field.save(tmp_path / "a.nc")
    assert PotentialField.load(tmp_path / "a.nc").voxmap.boundary == "subvoxel"
    with xr.open_dataset(tmp_path / "a.nc") as data:
        old = data.load()
    for boundary, expected in ((None, "staircase"), ("staircase", "staircase")):
        del old.attrs["boundary"]
        if boundary is not None:
            old.attrs["boundary"] = boundary
        old.to_netcdf(tmp_path / "b.nc")
        back = PotentialField.load(tmp_path / "b.nc")
        assert back.voxmap.boundary == expected
        old.attrs["boundary"] = "subvoxel"


def test_every_variable_carries_units(field, tmp_path):
    field.save(tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as data:
        assert data["potential"].attrs["units"] == "N cm-2"
        for name in data.variables:
            assert "units" in data[name].attrs, name
        assert "ttus_opt" in data.attrs["source"]


def test_a_changed_value_is_one_line(field, tmp_path):
    field.save(tmp_path / "a.nc")
    with netCDF4.Dataset(tmp_path / "a.nc", "a") as file:
        file["potential"][1, 2, 3] = 1e77
    with (
        pytest.warns(TtusWarning, match="has no checksum"),
        pytest.raises(FileError, match="tissue bears no more than 10000"),
    ):
        PotentialField.load(tmp_path / "a.nc")


def test_another_version_is_refused(field, tmp_path):
    field.save(tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as data:
        newer = data.load().assign_attrs(ttus_opt_version=99)
    newer.to_netcdf(tmp_path / "b.nc")
    with pytest.raises(FileError, match=r"version 99.*update ttus_opt"):
        PotentialField.load(tmp_path / "b.nc")


def altered(data, name, **attrs):
    """The same file with other attributes of one variable."""
    return data.assign({name: data[name].assign_attrs(attrs)})


DAMAGES = {
    "potential in kN": (
        lambda d: altered(d, "potential", units="kN"),
        "potential has units 'kN', expected 'N cm-2'",
    ),
    "potential of the other sampling": (
        lambda d: d.assign_attrs(sampling="voxel-mean"),
        "potential has units 'N cm-2', expected 'N'",
    ),
    "no such sampling": (
        lambda d: d.assign_attrs(sampling="nearest"),
        "contact-size, contact-size:LENGTH in m, got 'nearest'",
    ),
    "region of two by two": (
        lambda d: d.assign(
            region=(("a", "b"), np.ones((2, 2), np.int8), {"units": "1"})
        ),
        "region has dimensions (a, b), expected (r, theta, z)",
    ),
    "region of two by two by name": (
        lambda d: d.drop_vars("region").assign(
            region=(("r", "theta"), np.ones((8, 12), np.int8), {"units": "1"})
        ),
        "region has dimensions (r, theta), expected (r, theta, z)",
    ),
    "region of no meaning": (
        lambda d: d.assign(region=d["region"] * 2).pipe(altered, "region", units="1"),
        "region must hold 1 inside, 0 on the surface and -1 outside only",
    ),
    "transposed": (
        lambda d: d.assign(potential=d["potential"].transpose("z", "theta", "r")),
        "potential has dimensions (z, theta, r), expected (r, theta, z)",
    ),
    "radius in mm": (
        lambda d: altered(d, "radius", units="mm"),
        "radius has units 'mm', expected 'm'",
    ),
    "deviation without units": (
        lambda d: d.assign(radius_std=(d["radius_std"].dims, d["radius_std"].data)),
        "radius_std has units None, expected 'm'",
    ),
    "angles in degrees": (
        lambda d: altered(
            d.assign_coords(theta=np.degrees(d["theta"])), "theta", units="degree"
        ),
        "theta has units 'degree', expected 'rad'",
    ),
    "heights of another grid": (
        lambda d: altered(d.assign_coords(z=2.0 * d["z"]), "z", units="m"),
        "z is not where grid_limits puts the voxels",
    ),
    "limits of two numbers": (
        lambda d: d.assign_attrs(grid_limits="[0.03, 0.14]"),
        "not enough values to unpack",
    ),
    "limits of no number": (
        lambda d: d.assign_attrs(grid_limits='["a", 0.14, 0.0, 0.2]'),
        "must be real number",
    ),
    "a parameter that is NaN": (
        lambda d: d.assign_attrs(parameters='{"boundary_scale": NaN}'),
        "parameter boundary_scale must be a finite number, got nan",
    ),
    "parameters that are a list": (
        lambda d: d.assign_attrs(parameters="[1.0]"),
        "attribute parameters must be a JSON object, got '[1.0]'",
    ),
    "parameters of no text": (
        lambda d: d.assign_attrs(parameters=5.0),
        "attribute parameters must be text, got np.float64(5.0)",
    ),
    "no such boundary": (
        lambda d: d.assign_attrs(boundary="cubist"),
        "boundary must be one of subvoxel, staircase, got 'cubist'",
    ),
    "a boundary of 10,000 letters": (
        lambda d: d.assign_attrs(boundary=10_000 * "x"),
        f"got '{39 * 'x'}…",
    ),
    "a boundary that is a number": (
        lambda d: d.assign_attrs(boundary=3.0),
        "attribute boundary must be text, got np.float64(3.0)",
    ),
    "two boundaries": (
        lambda d: d.assign_attrs(boundary=np.array([1.0, 2.0])),
        "attribute boundary must be text, got array([1., 2.])",
    ),
    "an empty boundary": (
        lambda d: d.assign_attrs(boundary=""),
        "attribute boundary must be text, got ''",
    ),
    "no region": (lambda d: d.drop_vars("region"), "it has no variable region"),
}


@pytest.mark.parametrize(("damage", "told"), DAMAGES.values(), ids=DAMAGES)
def test_what_is_no_field_is_refused_in_one_line(field, tmp_path, damage, told):
    """Units, dimensions and places of all that a field file holds."""
    field.save(tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as data:
        damage(data.load()).to_netcdf(tmp_path / "b.nc")
    caught = refuses(FileError, re.escape(told), PotentialField.load, tmp_path / "b.nc")
    assert "b.nc: damaged field file" in caught


def test_refusals(field):
    voxmap = field.voxmap
    with pytest.raises(InputError, match="shape"):
        PotentialField(voxmap, np.zeros((8, 6, 12)), "trilinear")
    with pytest.raises(InputError, match="NaN"):
        PotentialField(voxmap, np.full((8, 12, 6), np.nan), "trilinear")
    with pytest.raises(InputError, match="sampling"):
        PotentialField(voxmap, np.zeros((8, 12, 6)), "nearest")
    with pytest.raises(InputError, match=r"region must have the grid's shape \(8, 12"):
        Voxmap(voxmap.grid, voxmap.surface, np.ones((2, 2), np.int8))


def test_the_dataset_is_what_is_saved(field, tmp_path):
    field.save(tmp_path / "a.nc")
    given = field.to_xarray()
    with xr.open_dataset(tmp_path / "a.nc") as saved:
        xr.testing.assert_equal(saved.load(), given)
        for name in given.variables:
            assert saved[name].attrs["units"] == given[name].attrs["units"]
        assert given.attrs.items() <= saved.attrs.items()
    np.testing.assert_array_equal(given["potential"], field.values)
    assert given["potential"].dims == ("r", "theta", "z")


@pytest.mark.parametrize("n", NUMBERS)
@pytest.mark.filterwarnings("ignore")
def test_mutated_files_raise_nothing_but_our_own(n, field, tmp_path):
    field.save(tmp_path / "field.nc")
    field.voxmap.surface.save(tmp_path / "surface.nc")
    only_our_errors([tmp_path / "field.nc"], PotentialField.load, n // 4)
    only_our_errors([tmp_path / "surface.nc"], Surface.load, n // 4)
