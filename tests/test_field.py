from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from tests.conftest import torso
from ttus_opt.errors import FileError, InputError
from ttus_opt.field import PotentialField
from ttus_opt.voxmap import Voxmap


@pytest.fixture
def field() -> PotentialField:
    voxmap = Voxmap.from_surface(torso(), shape=(8, 12, 6))
    values = np.random.default_rng(0).normal(size=(8, 12, 6))
    return PotentialField(
        voxmap, values, "trilinear", {"boundary_scale": 2.5}, {"solver": "none"}
    )


def test_round_trip(field: PotentialField, tmp_path: Path) -> None:
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


def test_every_variable_carries_units(field: PotentialField, tmp_path: Path) -> None:
    field.save(tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as data:
        assert data["potential"].attrs["units"] == "N cm-2"
        for name in data.variables:
            assert "units" in data[name].attrs, name
        assert "ttus_opt" in data.attrs["source"]


def test_another_version_is_refused(field: PotentialField, tmp_path: Path) -> None:
    field.save(tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as data:
        newer = data.load().assign_attrs(ttus_opt_version=99)
    newer.to_netcdf(tmp_path / "b.nc")
    with pytest.raises(FileError, match=r"version 99.*update ttus_opt"):
        PotentialField.load(tmp_path / "b.nc")


def test_a_damaged_file_is_one_line(field: PotentialField, tmp_path: Path) -> None:
    field.save(tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as data:
        data.load().drop_vars("region").to_netcdf(tmp_path / "b.nc")
    with pytest.raises(FileError, match="damaged") as caught:
        PotentialField.load(tmp_path / "b.nc")
    assert "\n" not in str(caught.value)


def test_refusals(field: PotentialField) -> None:
    voxmap = field.voxmap
    with pytest.raises(InputError, match="shape"):
        PotentialField(voxmap, np.zeros((8, 6, 12)), "trilinear")
    with pytest.raises(InputError, match="NaN"):
        PotentialField(voxmap, np.full((8, 12, 6), np.nan), "trilinear")
    with pytest.raises(InputError, match="sampling"):
        PotentialField(voxmap, np.zeros((8, 12, 6)), "nearest")
