"""Names of samplings, and the length that one of them takes."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.drags import end_share
from tests.kit import InputError, refuses, torso
from ttus_opt.contact.rows import contact_rows
from ttus_opt.probe.cylindrical import cylindrical
from ttus_opt.voxmap.sampling import (
    check_sampling,
    field_unit,
    least_length,
    sized,
    spoke_cell,
    spoke_table,
)


@pytest.mark.parametrize(
    ("name", "length", "unit"),
    [
        ("voxel-mean", 0.0, "N"),
        ("trilinear", 0.0, "N cm-2"),
        ("contact-size", 0.005, "N cm-2"),
        ("contact-size:0.018", 0.018, "N cm-2"),
    ],
)
def test_a_name_has_a_length_and_a_unit(name, length, unit):
    check_sampling(name)
    assert least_length(name) == length and field_unit(name) == unit


def test_a_length_is_written_in_three_digits():
    assert sized(0.0178499) == "contact-size:0.0178"
    assert least_length(sized(1.23456e-4)) == 1.23e-4


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("nearest", "one of voxel-mean, .*contact-size:LENGTH in m, got 'nearest'"),
        ("trilinear:0.01", "got 'trilinear:0.01'"),
        ("contact-size:", "must be 0.0001 to 1 m, got ''"),
        ("contact-size:18", "must be 0.0001 to 1 m, got '18'"),
        ("contact-size:18mm", "got '18mm'"),
        ("contact-size:nan", "got 'nan'"),
    ],
)
def test_other_names_are_refused(name, told):
    refuses(InputError, told, check_sampling, name)


#: Four points in one place, 1 cm² together: a pose's x-force is the field there
POINT = tt.PointShell(
    np.zeros((4, 3)), np.tile([1.0, 0, 0], (4, 1)), np.full(4, 0.25e-4), np.zeros(3)
)
SAMPLINGS = ["voxel-mean", "trilinear"]


def rows_at(voxmap, places, sampling):
    turns = np.tile(np.eye(3), (len(places), 1, 1))
    return contact_rows(voxmap, POINT, turns, places, sampling=sampling)


def sampled(voxmap, values, places, sampling="trilinear"):
    return (rows_at(voxmap, places, sampling).N @ values.reshape(-1))[::3]


def bumpy(n_theta=180, n_z=61):
    theta = np.arange(n_theta)[:, None] * 2 * np.pi / n_theta
    z = np.linspace(0.0, 0.2, n_z)
    return tt.Surface.from_radius(
        0.1 + 0.012 * np.sin(3 * theta + 20 * z) + 0.01 * np.cos(40 * z), z
    )


def depths_of_voxels(voxmap):
    grid = voxmap.grid
    skin = voxmap.surface.radius_at(grid.theta[:, None], grid.z)
    return np.asarray(skin - grid.r[:, None, None])


def places_below(surface, depth, rng):
    """Random places at given depths: Cartesian, and their θ and z."""
    theta = rng.uniform(0.0, 2 * np.pi, depth.size)
    z = rng.uniform(surface.z[0], surface.z[-1], depth.size)
    r = surface.radius_at(theta, z) - depth
    return np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=1), theta, z


@pytest.mark.parametrize("shape", [(24, 40, 21), (12, 32, 16), (40, 36, 12)])
def test_a_field_that_grows_linearly_with_depth_is_exact(shape):
    """Whatever the skin's slope, and whatever stands on it and outside."""
    rng = np.random.default_rng(0)
    voxmap = tt.Voxmap.from_surface(bumpy(), shape=shape)
    below = depths_of_voxels(voxmap)
    values = np.where(below > voxmap.grid.r_step / 2, 100.0 * below, 1e6)
    depth = rng.uniform(0.0, 0.04, 800)
    places, _, z = places_below(voxmap.surface, depth, rng)
    depth *= end_share(voxmap.grid, z)
    found = sampled(voxmap, values, places)
    np.testing.assert_allclose(found, 100.0 * depth, atol=1e-11)


def test_second_order_on_a_bumpy_skin():
    """p = φ(depth) g(θ, z), φ(0) = 0, to the skin itself."""
    surface, rng = bumpy(), np.random.default_rng(1)
    depth = rng.uniform(0.0, 0.03, 6000)
    places, theta, z = places_below(surface, depth, rng)

    def field(d, theta, z):
        return np.sin(60.0 * d) * (2.0 + np.sin(2 * theta) * np.cos(15 * z))

    errors = []
    for n in (1, 2, 4):
        shape = (12 * n, 16 * n, 8 * n + 1)
        voxmap = tt.Voxmap.from_surface(surface, shape=shape, r_outer=0.14)
        grid = voxmap.grid
        values = field(depths_of_voxels(voxmap), grid.theta[:, None], grid.z)
        miss = sampled(voxmap, values, places)
        miss -= field(depth * end_share(grid, z), theta, z)
        errors.append(np.sqrt((miss**2).mean()))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(order, 2.0, atol=0.2)


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_the_skins_layer_and_the_outside_are_never_sampled(sampling):
    rng = np.random.default_rng(2)
    voxmap = tt.Voxmap.from_surface(bumpy(), shape=(24, 40, 21))
    depth = 10.0 ** rng.uniform(-9.0, -1.5, 1000)
    rows = rows_at(voxmap, places_below(voxmap.surface, depth, rng)[0], sampling)
    nearest = np.abs(depths_of_voxels(voxmap)).argmin(axis=0)
    along_x = rows.N[::3]
    i, j, k = np.unravel_index(along_x.indices, voxmap.grid.shape)
    assert (i < nearest[j, k]).all()
    assert (along_x.data > 0.0).all()
    assert (rows.contact_points == 4).all()


@pytest.mark.parametrize("shape", [(24, 40, 21), (12, 32, 16), (48, 120, 60)])
def test_values_start_from_zero_at_the_skin(shape):
    """On any grid, on any slope of the skin; here they are 1 inside and outside."""
    rng = np.random.default_rng(3)
    voxmap = tt.Voxmap.from_surface(bumpy(), shape=shape)
    ones, step = np.ones(voxmap.grid.shape), voxmap.grid.r_step
    depth = 10.0 ** rng.uniform(-9.0, -3.0, 500)
    places = places_below(voxmap.surface, depth, rng)[0]
    found = sampled(voxmap, ones, places)
    assert (found <= 2.0 * depth / step + 1e-12).all()
    assert (found > 0.0).all()
    touching = places_below(voxmap.surface, np.full(500, 1e-12), rng)[0]
    assert not sampled(voxmap, ones, touching, "voxel-mean").any()
    assert sampled(voxmap, ones, places, "voxel-mean").any()


@pytest.mark.parametrize("sampling", SAMPLINGS)
@pytest.mark.parametrize("r_inner", [0.03, 0.06])
def test_beyond_the_inner_layer_its_values_go_on(sampling, r_inner):
    rng = np.random.default_rng(4)
    voxmap = tt.Voxmap.from_surface(torso(), shape=(24, 40, 21), r_inner=r_inner)
    grid = voxmap.grid
    values = rng.uniform(1.0, 2.0, grid.shape)
    values[0] = 5.0
    n = 200
    r = np.concatenate([[0.0, 1e-300, 1e-9], rng.uniform(0.0, 0.9 * r_inner, n - 3)])
    theta, z = rng.uniform(0.0, 2 * np.pi, n), rng.uniform(0.05, 0.15, n)
    # deeper than any of the four spokes goes, whose skins differ by some millimetres
    r[3:] -= np.minimum(r[3:], 0.01)
    places = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=1)
    rows = rows_at(voxmap, places, sampling)
    np.testing.assert_allclose((rows.N @ values.reshape(-1))[::3], 5.0, rtol=1e-14)
    assert rows.in_grid.all()
    assert (rows.beyond_inner == 4).all()


@pytest.mark.slow
def test_no_jump_where_a_point_passes_the_inner_layer_or_any_other():
    """Along one line almost to the axis, in steps of 1 µm, then of half a µm."""
    rng = np.random.default_rng(5)
    voxmap = tt.Voxmap.from_surface(torso(), shape=(24, 40, 21), r_inner=0.04)
    values = rng.uniform(0.0, 1.0, voxmap.grid.shape)
    jumps = []
    for n in (100_001, 200_001):
        r = np.linspace(0.1, 0.001, n)
        line = np.stack([r * np.cos(1.3), r * np.sin(1.3), 0 * r + 0.093], axis=1)
        found = sampled(voxmap, values, line)
        assert found[r > voxmap.surface.radius_at(np.array(1.3), 0.093)].max() == 0.0
        jumps.append(np.abs(np.diff(found)).max())
    assert jumps[1] == pytest.approx(jumps[0] / 2, rel=0.01)


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_points_on_the_first_and_the_last_slice(sampling):
    """An index past the last slice would be the next spoke's first voxel."""
    voxmap = tt.Voxmap.from_surface(torso(), shape=(24, 40, 21))
    grid = voxmap.grid
    values = np.zeros(grid.shape)
    values[:, :, 0], values[:, :, -1] = 3.0, 4.0
    angle = np.linspace(0.0, 2 * np.pi, 41)  # the last spoke too, and the turn itself
    x, y = 0.05 * np.cos(angle), 0.05 * np.sin(angle)
    off = 0.45 * grid.z_step  # there voxel-mean is in contact, as in the first slice
    for height, value in ((grid.z_min + off, 3.0), (grid.z_max - off, 4.0)):
        places = np.stack([x, y, np.full_like(x, height)], axis=1)
        rows = rows_at(voxmap, places, sampling)
        assert rows.N.indices.max(initial=0) < grid.n_voxels
        share = 1.0 if sampling == "voxel-mean" else 0.55
        np.testing.assert_allclose((rows.N @ values.reshape(-1))[::3], share * value)


def test_the_table_holds_the_skin_of_every_spoke():
    voxmap = tt.Voxmap.from_surface(bumpy(), shape=(24, 40, 21))
    grid = voxmap.grid
    table = spoke_table(voxmap).reshape(40, 21, 3)
    skin = voxmap.surface.radius_at(grid.theta[:, None], grid.z)
    np.testing.assert_allclose(grid.r_inner + table[..., 0] * grid.r_step, skin)
    gap = skin - grid.r[table[..., 1].astype(int)]
    assert gap.min() > 0.499 * grid.r_step
    assert gap.max() < 1.501 * grid.r_step
    np.testing.assert_allclose(table[..., 2], grid.r_step / gap)


def test_voxel_mean_is_the_voxels_value_away_from_the_skin():
    rng = np.random.default_rng(6)
    voxmap = tt.Voxmap.from_surface(torso(), shape=(24, 40, 21))
    grid = voxmap.grid
    values = rng.normal(size=grid.shape)
    places, _, z = places_below(voxmap.surface, rng.uniform(0.02, 0.05, 300), rng)
    places = places[end_share(grid, z) == 1.0]
    r, theta, z = cylindrical(places)
    i = np.abs(grid.r - r[:, None]).argmin(axis=1)
    j = np.abs(np.exp(1j * grid.theta) - np.exp(1j * theta)[:, None]).argmin(axis=1)
    k = np.abs(grid.z - z[:, None]).argmin(axis=1)
    np.testing.assert_allclose(
        sampled(voxmap, values, places, "voxel-mean"), values[i, j, k], rtol=1e-14
    )


def test_the_last_slice_is_sampled_within_the_last_cell():
    """At the top there is no spoke above: the cell below, at its upper end."""
    voxmap = tt.Voxmap.from_surface(torso(), shape=(9, 20, 10))
    grid = voxmap.grid
    for theta in (*grid.theta, np.nextafter(2 * np.pi, 0.0)):
        j, j_next, k, _, w = spoke_cell(theta, grid.z_max, grid.kernel_limits, 20, 10)
        assert 0 <= j < 20 and 0 <= j_next < 20
        assert k == 8  # k + 1 is the last slice
        assert w == pytest.approx(1.0)
