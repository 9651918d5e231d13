import numpy as np
import pytest

from tests.kit import GeometryError, InputError, refuses, torso
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.voxmap import INSIDE, OUTSIDE, SURFACE, Voxmap


def cylinder(radius, n_theta=12, n_z=4):
    return Surface.from_radius(
        np.full((n_theta, n_z), radius), np.linspace(0.0, 0.2, n_z)
    )


def test_a_surface_is_its_nearest_layer():
    """Exactly that layer, of those at 3, 4, … 15 cm; at 9 cm it lies on one."""
    for radius, layer in ((0.09, 6), (0.0949, 6), (0.0951, 7), (0.0851, 6)):
        voxmap = Voxmap.from_surface(
            cylinder(radius), shape=(13, 12, 5), r_inner=0.03, r_outer=0.15
        )
        assert (voxmap.region[layer] == SURFACE).all()
        assert (voxmap.region[:layer] == INSIDE).all()
        assert (voxmap.region[layer + 1 :] == OUTSIDE).all()


def rough(seed):
    rng = np.random.default_rng(seed)
    return Surface.from_radius(rng.uniform(0.05, 0.12, (24, 9)), np.linspace(0, 0.2, 9))


@pytest.mark.parametrize("boundary", ["subvoxel", "staircase"])
@pytest.mark.parametrize(
    "surface", [torso(), rough(0), rough(1)], ids=["torso", "rough", "rough2"]
)
def test_inside_and_outside_never_touch(surface, boundary):
    region = Voxmap.from_surface(surface, shape=(30, 24, 9), boundary=boundary).region
    for axis in range(3):
        product = region * np.roll(region, -1, axis)
        if axis != 1:  # only θ closes on itself
            product = np.delete(product, -1, axis)
        assert (product >= 0).all()


def test_added_surface_voxels_lie_at_the_surface_no_thicker_than_needed():
    voxmap = Voxmap.from_surface(torso(), shape=(40, 90, 31), boundary="staircase")
    grid = voxmap.grid
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    distance = np.abs(grid.r[:, None, None] - torso().radius_at(theta, z)[None])
    thick = voxmap.on_surface
    per_spoke = thick.sum(axis=0)
    assert (per_spoke >= 1).all()
    assert per_spoke.mean() < 2.0
    assert distance[thick].max() < 3 * grid.r_step


def test_below_the_nearest_layer_every_voxel_stays_inside():
    """A staircase closed from inside would be 0 where a steep surface is pressed."""
    voxmap = Voxmap.from_surface(rough(0), shape=(30, 24, 9))
    depth = voxmap.surface_place[None] - np.arange(30)[:, None, None]
    assert (voxmap.region[depth > 0.5] == INSIDE).all()
    assert (voxmap.region[depth <= 0.5] != INSIDE).all()
    closed = Voxmap.from_surface(rough(0), shape=(30, 24, 9), boundary="staircase")
    assert (closed.region[depth > 0.5] == SURFACE).any()


def test_dirichlet_voxels_are_surface_layers_and_ends():
    fixed = Voxmap.from_surface(cylinder(0.09), shape=(13, 12, 5)).dirichlet
    assert fixed[[0, -1]].all()
    assert fixed[..., [0, -1]].all()
    assert not fixed[1, 0, 2]


@pytest.mark.parametrize(
    ("options", "error", "word"),
    [
        ({"shape": (24, 0, 30)}, InputError, "n_theta"),
        ({"shape": (24, 72)}, InputError, "three whole numbers"),
        ({"shape": (24.5, 72, 30)}, InputError, "whole numbers"),
        ({"r_inner": 0.2, "r_outer": 0.4}, GeometryError, "choose r_inner below"),
        ({"r_outer": 0.08}, GeometryError, "larger r_outer"),
        ({"shape": (4000, 4000, 4000)}, InputError, "GiB"),
        ({"boundary": "smooth"}, InputError, "subvoxel, staircase, got 'smooth'"),
    ],
)
def test_refusals(options, error, word):
    refuses(error, word, Voxmap.from_surface, cylinder(0.09), **options)


def test_a_crest_between_spokes_must_not_leave_the_grid():
    """Contact there lay beyond the outer layer, and pressed with 0 N."""
    radius = np.full((48, 3), 0.1)
    radius[2::4] = 0.118
    ridged = Surface.from_radius(radius, np.linspace(0.0, 0.2, 3))
    given = {"shape": (9, 12, 9), "r_outer": 0.11}
    refuses(GeometryError, r"reaches 0.118 m", Voxmap.from_surface, ridged, **given)
    usual = Voxmap.from_surface(ridged, shape=(9, 12, 9)).grid
    assert usual.r_outer == pytest.approx(0.138)


def test_the_memory_estimate_is_told_before_anything_is_allocated():
    words = r"1,080,000 voxels takes about 0\.5 GiB"
    large = {"shape": (100, 180, 60), "memory_limit": 0.25 * 2**30}
    refuses(InputError, words, Voxmap.from_surface, cylinder(0.09), **large)


@pytest.mark.parametrize("sector", [None, (0.4, 2.6)])
def test_the_cosine_of_a_spoke_is_that_of_a_cylinder_off_the_axis_and_of_a_cone(sector):
    """Errors decrease with the square of the step around; a cone's slope is exact."""
    theta, z = (
        np.linspace(0.0, 2.0 * np.pi, 1440, endpoint=False),
        np.linspace(0, 0.3, 7),
    )
    off, a, slope = 0.03, 0.11, 0.3

    def radius(theta):
        return off * np.cos(theta) + np.sqrt(a**2 - (off * np.sin(theta)) ** 2)

    offset = np.repeat(radius(theta)[:, None], len(z), axis=1)
    cone = np.repeat(0.08 + slope * (z[None] - 0.1), len(theta), axis=0)
    errors = []
    for n in (30, 60):
        shape, surface = (12, n, 7), Surface.from_radius(offset, z)
        voxmap = Voxmap.from_surface(surface, shape=shape, sector=sector)
        at = voxmap.grid.theta
        exact = (radius(at) - off * np.cos(at)) / a
        errors.append(np.abs(voxmap.spoke_cosine - exact[:, None]).max())
    assert errors[0] < 4e-3 and errors[1] < 0.35 * errors[0]
    along = Voxmap.from_surface(Surface.from_radius(cone, z), shape=shape)
    exact = 1.0 / np.hypot(1.0, slope)
    np.testing.assert_allclose(along.spoke_cosine, exact, atol=1e-12)
