"""The surface's bilinear radius, its file, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

import ttus_opt as tt
from tests.kit import FileError, GeometryError, InputError, refuses, shared_data, torso


def wavy(n_theta=12, n_z=7, seed=0):
    rng = np.random.default_rng(seed)
    surface = tt.Surface.from_radius(
        0.15 + 0.02 * rng.standard_normal((n_theta, n_z)),
        np.linspace(-0.1, 0.2, n_z),
        axis=tt.Axis(rng.standard_normal(3), np.eye(3)[[1, 2, 0]]),
    )
    std = rng.uniform(0, 0.01, surface.radius.shape)
    return replace(surface, radius_std=std, observed=std < 0.005)


@given(st.integers(4, 40), st.integers(2, 20), st.integers(0, 1000))
@settings(max_examples=30)
def test_bilinear_against_scipy(n_theta, n_z, seed):
    s = wavy(n_theta, n_z, seed)
    rng = np.random.default_rng(seed)
    theta = rng.uniform(0, 2 * np.pi, 50)
    z = rng.uniform(s.z[0] - 0.1, s.z[-1] + 0.1, 50)
    reference = RegularGridInterpolator(
        (np.append(s.theta, 2 * np.pi), s.z), np.vstack([s.radius, s.radius[:1]])
    )
    clamped = np.clip(z, s.z[0], s.z[-1])
    expected = reference(np.stack([theta, clamped], axis=1))
    np.testing.assert_allclose(s.radius_at(theta, z), expected, atol=1e-12)


def test_nodes_are_met_and_angles_wrap():
    s = wavy()
    at_nodes = s.radius_at(s.theta[:, None], s.z)
    np.testing.assert_allclose(at_nodes, s.radius, atol=1e-14)
    theta = np.linspace(-1, 1, 33)
    for turns in (-3, 1, 4):
        turned = s.radius_at(theta + 2 * np.pi * turns, 0.05)
        np.testing.assert_allclose(turned, s.radius_at(theta, 0.05), atol=1e-12)
    assert s.radius_at(0.3, 0.1).shape == ()


def test_points_lie_on_the_radius():
    s = wavy()
    x, y, z = np.moveaxis(s.points(), -1, 0)
    np.testing.assert_allclose(np.hypot(x, y), s.radius)
    np.testing.assert_allclose(np.arctan2(y, x) % (2 * np.pi), s.theta[:, None] + 0 * x)
    np.testing.assert_array_equal(z, np.broadcast_to(s.z, z.shape))


def test_file_round_trip(tmp_path):
    s = wavy()
    s.save(tmp_path / "new" / "surface.nc")
    again = tt.Surface.load(tmp_path / "new" / "surface.nc")
    for name in ("theta", "z", "radius", "radius_std", "observed"):
        np.testing.assert_array_equal(getattr(again, name), getattr(s, name))
    np.testing.assert_array_equal(again.axis.origin, s.axis.origin)
    np.testing.assert_array_equal(again.axis.rotation, s.axis.rotation)
    with xr.open_dataset(tmp_path / "new" / "surface.nc", engine="netcdf4") as file:
        assert all("units" in file[name].attrs for name in file.variables)


def test_file_from_elsewhere(tmp_path):
    """Only radius(theta, z), stored transposed."""
    s = wavy()
    data = xr.Dataset(
        {"radius": (("z", "theta"), s.radius.T, {"units": "m"})},
        coords={"theta": s.theta, "z": s.z},
    )
    data.to_netcdf(tmp_path / "foreign.nc", engine="netcdf4")
    again = tt.Surface.load(tmp_path / "foreign.nc")
    np.testing.assert_allclose(again.radius, s.radius)
    assert again.observed.all() and not again.radius_std.any()
    np.testing.assert_array_equal(again.axis.rotation, np.eye(3))


def _file(path, *, units="m", **changes):
    s = wavy()
    data = xr.Dataset(
        {"radius": (("theta", "z"), s.radius, {"units": units})},
        coords={"theta": s.theta, "z": s.z},
    ).assign(**changes)
    data.to_netcdf(path, engine="netcdf4")
    return path


def test_bad_files(tmp_path):
    refuses(FileError, "not found", tt.Surface.load, tmp_path / "none.nc")
    (tmp_path / "text.nc").write_text("hello")
    refuses(FileError, "not a readable netCDF", tt.Surface.load, tmp_path / "text.nc")
    deviation = (("theta", "z"), wavy().radius_std, {"units": "cm"})
    for k, (told, changed) in enumerate([
        ("'mm', expected 'm'", {"units": "mm"}),
        ("z has units 'mm'", {"z": ("z", 1000.0 * wavy().z, {"units": "mm"})}),
        ("radius_std has units 'cm', expected 'm'", {"radius_std": deviation}),
        ("no variable radius", {"radius": ("z", np.zeros(7))}),
        ("equal steps", {"z": np.linspace(0, 1, 7) ** 2}),
    ]):  # fmt: skip
        file = _file(tmp_path / f"{k}.nc", **changed)
        refuses(FileError, told, tt.Surface.load, file)
    wavy().save(tmp_path / "s.nc")
    raw = (tmp_path / "s.nc").read_bytes()
    (tmp_path / "cut.nc").write_bytes(raw[: len(raw) // 2])
    refuses(FileError, "truncated", tt.Surface.load, tmp_path / "cut.nc")


@pytest.mark.parametrize(
    "damage",
    [
        lambda d: d.assign_coords(z=1000.0 * d["z"]),
        lambda d: d.assign(radius_std=d["radius_std"] + np.nan),
        lambda d: d.assign(radius_std=d["radius_std"] + 1e300),
        lambda d: d.assign(radius_std=d["radius_std"] - 1.0),
        lambda d: d.assign(observed=d["observed"] * np.nan),
        lambda d: d.assign_coords(theta=[f"{t:.3f}" for t in d["theta"].values]),
        lambda d: d.assign(radius=d["radius"].astype(str).astype(object) + " m"),
        lambda d: d.assign_attrs(axis_origin="[NaN, 0, 0]"),
        lambda d: d.assign_attrs(axis_origin="{}"),
        lambda d: d.assign_attrs(axis_origin="[[0, 1], [2]]"),
        lambda d: d.assign_attrs(axis_origin="null"),
        lambda d: d.assign_attrs(axis_origin=5.0),
        lambda d: d.assign_attrs(axis_rotation=np.arange(9.0)),
        lambda d: d.drop_attrs().assign_attrs(axis_origin="[0, 0, 0]"),
    ],
    ids=[
        "heights in mm",
        "deviations of NaN",
        "endless deviations",
        "negative deviations",
        "a mask of NaN",
        "angles as text",
        "radii as text",
        "NaN origin",
        "no array",
        "ragged",
        "null",
        "a number",
        "an array",
        "no rotation",
    ],
)
def test_hostile_files_are_one_line(tmp_path, damage):
    wavy().save(tmp_path / "s.nc")
    with xr.open_dataset(tmp_path / "s.nc") as data:
        bad = damage(data.load())
    bad["radius"].attrs = {"units": "m"}
    bad.to_netcdf(tmp_path / "bad.nc")
    told = refuses(FileError, "", tt.Surface.load, tmp_path / "bad.nc")
    assert "bad.nc" in told
    assert not {"float", "array", "sequence"} & set(told.split())


def test_no_coordinates_in_the_file(tmp_path):
    data = xr.Dataset({"radius": (("theta", "z"), wavy().radius, {"units": "m"})})
    data.to_netcdf(tmp_path / "bare.nc", engine="netcdf4")
    refuses(FileError, "", tt.Surface.load, tmp_path / "bare.nc")


def test_unusable_surfaces():
    s = wavy()
    refuses(InputError, "transposed", replace, s, radius=s.radius.T)
    with pytest.raises(InputError, match="at least 4 angles"):
        tt.Surface.from_radius(np.ones((3, 5)), np.arange(5.0))
    refuses(InputError, "full turn", replace, s, theta=s.theta / 2)
    refuses(InputError, "equal steps", replace, s, z=s.z[::-1].copy())
    for bad in (np.nan, 0.0, -0.1, np.inf):
        radius = s.radius.copy()
        radius[2, 3] = bad
        refuses(GeometryError, "1 of 84 surface radii", replace, s, radius=radius)
    with pytest.raises(InputError, match=r"\(n_theta, n_z\)"):
        tt.Surface.from_radius(np.ones(5), np.arange(5.0))


def test_shared_surface_file():
    path = shared_data("phantom/surface.nc")
    s = tt.Surface.load(path)
    assert 0.05 < s.radius.min() < s.radius.max() < 0.3
    assert s.radius_at(0.5, float(s.z.mean())) > 0.05


def test_the_front_is_what_was_seen():
    assert torso().front.tolist() == [0.0, 1.0, 0.0]
    right = np.abs(np.angle(np.exp(1j * torso().theta))) < 1.0
    one_side = replace(torso(), observed=np.repeat(right[:, None], 31, axis=1))
    np.testing.assert_allclose(one_side.front, [1.0, 0.0, 0.0], atol=1e-6)
