"""A grid over a sector of θ: what may be one, its voxels, its file, what it renders."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.kit import (
    FileError,
    GeometryError,
    InputError,
    ellipsoid,
    presses,
    refuses,
    torso,
)
from ttus_opt.contact.rows import contact_rows
from ttus_opt.core import io
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.probe.cylindrical import cylindrical
from ttus_opt.voxmap.field import KIND, VERSION, PotentialField
from ttus_opt.voxmap.grid import (
    CylindricalGrid,
    Sector,
    check_seen,
    flat_index,
    largest_radius,
    nodes_of,
)
from ttus_opt.voxmap.voxmap import SURFACE, Voxmap

GRID = CylindricalGrid(0.03, 0.13, 0.0, 0.2, (6, 8, 5))


def test_centres_and_steps():
    assert GRID.n_voxels == 240
    np.testing.assert_allclose(GRID.r[[0, -1]], [0.03, 0.13])
    np.testing.assert_allclose(np.diff(GRID.r), GRID.r_step)
    np.testing.assert_allclose(GRID.theta[-1] + GRID.theta_step, 2 * math.pi)
    np.testing.assert_allclose(GRID.z[[0, -1]], [0.0, 0.2])


def test_layout_is_c_order_in_numpy_and_in_kernels():
    values = np.arange(240).reshape(6, 8, 5)
    flat = GRID.flatten(values)
    assert flat[flat_index(3, 4, 2, 8, 5)] == values[3, 4, 2]
    np.testing.assert_array_equal(GRID.unflatten(flat), values)
    assert np.dot(GRID.strides, (3, 4, 2)) == flat_index(3, 4, 2, 8, 5)
    np.testing.assert_array_equal(values[nodes_of(flat[7:70], GRID.shape)], flat[7:70])


@pytest.mark.parametrize(
    ("change", "error", "word"),
    [
        ({"shape": (6, 0, 5)}, InputError, "n_theta"),
        ({"shape": (6, 8)}, InputError, "3 counts"),
        ({"r_outer": 0.02}, GeometryError, "r_outer"),
        ({"z_max": 0.0}, GeometryError, "z_max"),
        ({"r_inner": float("nan")}, InputError, "r_inner must be finite .m., got nan"),
        ({"r_inner": 0.001}, GeometryError, "half a radial step"),
    ],
)
def test_refuses_what_is_no_grid(change, error, word):
    given = {
        "r_inner": 0.03,
        "r_outer": 0.13,
        "z_min": 0.0,
        "z_max": 0.2,
        "shape": (6, 8, 5),
    }
    refuses(error, word, CylindricalGrid, **(given | change))


def test_wrong_lengths_are_named():
    refuses(InputError, r"\(6, 8, 5\)", GRID.flatten, np.zeros((8, 6, 5)))
    refuses(InputError, "240", GRID.unflatten, np.zeros(239))


def test_cylindrical_angles_lie_in_the_first_turn():
    points = np.array([[1.0, -1e-18, 0.5], [0.0, -2.0, 1.0], [-1.0, 0.0, 0.0]])
    r, theta, z = cylindrical(points)
    np.testing.assert_allclose(r, [1, 2, 1])
    np.testing.assert_allclose(theta, [0, 1.5 * math.pi, math.pi])
    assert (theta < 2 * math.pi).all()
    np.testing.assert_allclose(z, [0.5, 1.0, 0.0])


TURN = 2.0 * np.pi
ACROSS: Sector = (np.radians(-50.0), np.radians(70.0))


def field(sampling="trilinear", boundary="subvoxel"):
    """P grows with depth and angle, over a sector across θ = 0."""
    voxmap = Voxmap.from_surface(
        torso(), shape=(12, 13, 9), boundary=boundary, sector=ACROSS
    )
    depth = np.maximum(voxmap.surface_place - np.arange(12)[:, None, None], 0.0)
    values = depth * (1.0 + 0.1 * np.arange(13)[:, None])
    values[:, -1] = 1e4  # of the wall nothing may be read
    return PotentialField(voxmap, values, sampling)


def test_spokes_lie_in_the_middle_of_equal_parts_and_the_wall_beyond():
    grid = CylindricalGrid(0.03, 0.1, 0.0, 0.2, (5, 7, 4), ACROSS)
    assert grid.theta_step == pytest.approx(np.radians(20.0))
    np.testing.assert_allclose(
        np.degrees(grid.theta), [-40.0, -20.0, 0.0, 20.0, 40.0, 60.0, 80.0]
    )
    assert grid.wall == 6
    assert "θ -50° to 70°" in repr(grid)
    assert CylindricalGrid(0.03, 0.1, 0.0, 0.2, (5, 7, 4)).wall is None


@pytest.mark.parametrize(
    ("sector", "told"),
    [
        ((0.0, 0.0), "larger one"),
        ((1.0, 0.5), "larger one"),
        ((0.0, TURN), "less than a full turn"),
        ((0.0, 7.0), "less than a full turn"),
        ((0.0, float("nan")), "two angles"),
        ((0.0, float("inf")), "two angles"),
        ((0.0, 1e308), "two angles"),  # in degrees it is infinite
        ((0.0, 90.0), "two angles"),
        ((0.0, 1.0, 2.0), "two angles"),
        ((), "got none"),
        ((1.0, 1.08), "at least"),  # voxels too thin for multigrid
    ],
)
def test_a_bad_sector_is_refused_in_one_line(sector, told):
    options = {"shape": (8, 12, 6), "sector": sector}
    refuses(InputError, told, Voxmap.from_surface, torso(), **options)


def half_seen():
    """The torso, seen from 30° to 148° alone, and beyond that a radius of 0.3 m."""
    surface = torso()
    seen = (surface.theta > np.radians(29)) & (surface.theta < np.radians(149))
    radius = np.where(seen[:, None], surface.radius, 0.3)
    observed = np.broadcast_to(seen[:, None], radius.shape).copy()
    return replace(surface, radius=radius, observed=observed)


def test_angles_that_were_not_seen_are_not_invented():
    """The body that was not seen has no say: not in the layer, not in the extent."""
    words, wide = (
        r"5 of 35 angles.*within 32° to 148°",
        (np.radians(31), np.radians(171)),
    )
    options = {"shape": (8, 12, 6), "sector": wide}
    refuses(InputError, words, Voxmap.from_surface, half_seen(), **options)
    told = (np.radians(32), np.radians(148))
    seen = Voxmap.from_surface(half_seen(), shape=(8, 12, 6), sector=told)
    whole = Voxmap.from_surface(torso(), shape=(8, 12, 6), sector=told)
    assert seen.grid == whole.grid
    np.testing.assert_array_equal(seen.region, whole.region)
    assert largest_radius(half_seen(), told) < largest_radius(half_seen(), None)
    holes = half_seen().observed.copy()
    holes[:, 3:] = False  # seen somewhere is seen
    check_seen(replace(torso(), observed=holes), told)
    nothing = replace(torso(), observed=np.zeros_like(holes))
    refuses(InputError, "scan it", check_seen, nothing, told)


@pytest.mark.parametrize("boundary", ["subvoxel", "staircase"])
def test_links_to_the_wall_conduct_nothing(boundary):
    voxmap = field(boundary=boundary).voxmap
    assert (voxmap.region[:, -1] == SURFACE).all()
    links = voxmap.cut_links
    shape = voxmap.grid.shape
    spoke = np.unravel_index(links.neighbours, shape)[1]
    to_wall = spoke == voxmap.grid.wall
    # from every voxel beside it that is not in the layer, and along θ alone
    beside = voxmap.region[:, [0, -2]] != SURFACE
    assert to_wall.sum() == beside.sum()
    assert (links.factors[to_wall] == 0.0).all()
    assert (links.axes[to_wall] == 1).all()
    assert (links.factors[~to_wall] > 0.0).any() == (boundary == "subvoxel")


def test_a_file_says_the_sector(tmp_path):
    path = tmp_path / "field.nc"
    field().save(path)
    loaded = PotentialField.load(path)
    assert loaded.voxmap.grid == field().voxmap.grid
    np.testing.assert_array_equal(loaded.values, field().values)


@pytest.mark.parametrize(
    "text", ["[0.0]", "3", '"a"', "[0.0, NaN]", "[1.0, 0.5]", "[0.1, 2.0]", "[0, []]"]
)
def test_a_damaged_sector_is_told(tmp_path, text):
    data = field().to_xarray().assign_attrs(sector=text)
    io.write_dataset(data, tmp_path / "a.nc", kind=KIND, version=VERSION)
    refuses(FileError, "damaged field", PotentialField.load, tmp_path / "a.nc")


def around_the_sides(n):
    """Presses at angles inside, across both sides, and outside of the sector."""
    rng = np.random.default_rng(3)
    angle = rng.uniform(np.radians(-120), np.radians(150), n)
    z = rng.uniform(0.06, 0.14, n)
    r = torso().radius_at(angle, z) + 0.004
    position = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    return presses(torso(), n, rng).rotation, position


@pytest.mark.parametrize("sampling", ["trilinear", "voxel-mean", "contact-size"])
def test_points_beside_the_sector_are_not_in_contact(sampling):
    """Rows and frames, against every point one by one."""
    p, shell = field(sampling), ellipsoid()
    rotations, positions = around_the_sides(60)
    rows = contact_rows(p.voxmap, shell, rotations, positions, sampling=sampling)
    force = (rows.N @ p.values.reshape(-1)).reshape(-1, 3)
    renderer = Renderer(p, shell)
    outside = across = 0
    for t, (R, at) in enumerate(zip(rotations, positions, strict=True)):
        x, y, z = (shell.points @ R.T + at).T
        inside = p.voxmap.grid.in_sector(np.arctan2(y, x))
        depth = torso().radius_at(np.arctan2(y, x), z) - np.hypot(x, y)
        wrench = renderer.render(R, at)
        assert rows.contact_points[t] == (inside & (depth > 0.0)).sum()
        assert wrench.contact_points == rows.contact_points[t]
        in_grid = inside & (np.hypot(x, y) <= p.voxmap.grid.r_outer)
        assert wrench.in_grid == rows.in_grid[t] == in_grid.any()
        np.testing.assert_allclose(wrench.force, force[t], rtol=0, atol=1e-12)
        outside += not inside.any()
        across += inside.any() and not inside.all()
    assert outside > 5
    assert across > 5
    assert 0.0 < np.abs(force).max() < 1e5  # nothing of the wall


def test_between_side_and_first_spoke_nothing_changes():
    """A point samples the outermost spoke there, and both around it elsewhere."""
    p = field()
    table = []
    shell = ellipsoid(20, (6e-4, 6e-4, 6e-4))
    for degrees in (-49.9, -46.0, -44.0, 64.0, 66.0, 69.9):
        angle = np.radians(degrees)
        r = float(torso().radius_at(angle, 0.1)) - 0.01
        place = np.array([[r * np.cos(angle), r * np.sin(angle), 0.1]])
        rows = contact_rows(
            p.voxmap, shell, np.eye(3)[None], place, sampling="trilinear"
        )
        spokes = np.unravel_index(rows.N.indices, p.voxmap.grid.shape)[1]
        table.append(set(spokes[rows.N.data != 0.0].tolist()))
    assert table == [{0}, {0}, {0, 1}, {10, 11}, {11}, {11}]
