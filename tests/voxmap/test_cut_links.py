"""Where the surface cuts links, by hand and voxel by voxel."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from tests.kit import torso
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.cut_links import CutLinks
from ttus_opt.voxmap.voxmap import SURFACE, Voxmap


def tube(radius, boundary="subvoxel"):
    """Layers at 3, 4, … 15 cm around a cylinder."""
    surface = Surface.from_radius(np.full((8, 3), radius), np.array([0.0, 0.1, 0.2]))
    return Voxmap.from_surface(
        surface, shape=(13, 6, 4), r_inner=0.03, r_outer=0.15, boundary=boundary
    )


@pytest.mark.parametrize(
    ("radius", "inner", "outer"),
    [
        (0.09, 1.0, 1.0),  # on a layer: nothing is cut
        (0.094, 1.4, 0.6),  # beyond the layer at 9 cm, from 8 and from 10 cm
        (0.086, 0.6, 1.4),
    ],
)
def test_a_link_along_r_conducts_by_its_length(radius, inner, outer):
    voxmap = tube(radius)
    links = voxmap.cut_links
    assert (links.axes == 0).all()
    assert len(links.voxels) == 2 * 6 * 4
    layer = np.unravel_index(links.voxels, voxmap.grid.shape)[0]
    np.testing.assert_allclose(links.factors[layer == 5], 1.0 / inner, rtol=1e-9)
    np.testing.assert_allclose(links.factors[layer == 7], 1.0 / outer, rtol=1e-9)


def test_every_link_to_the_layer_is_there_once():
    """Neighbours counted voxel by voxel; where they meet the surface, by bisection."""
    voxmap = Voxmap.from_surface(torso(), shape=(10, 8, 6))
    grid, links = voxmap.grid, voxmap.cut_links
    expected = {}
    for a in itertools.product(*map(range, grid.shape)):
        for axis, step in itertools.product(range(3), (1, -1)):
            b = list(a)
            b[axis] += step
            b[1] %= grid.shape[1]
            if not all(0 <= n < size for n, size in zip(b, grid.shape, strict=True)):
                continue
            if voxmap.region[a] != SURFACE and voxmap.region[tuple(b)] == SURFACE:
                v, s = (int(np.ravel_multi_index(x, grid.shape)) for x in (a, b))
                expected[v, s] = axis
    found = zip(links.voxels.tolist(), links.neighbours.tolist(), strict=True)
    assert dict(zip(found, links.axes.tolist(), strict=True)) == expected
    assert len(links.voxels) == len(expected)
    assert (links.factors >= 0.0).all()
    inside = voxmap.region.reshape(-1)[links.voxels] > 0
    assert (links.factors[inside] > 0.0).all()
    assert links.factors[inside & (links.axes == 0)].max() < 2.0


def test_a_region_of_another_surface_is_counted():
    voxmap = tube(0.09)
    assert voxmap.cut_links.misplaced == 0
    other = replace(voxmap, surface=tube(0.099).surface)
    assert other.cut_links.misplaced == 24  # from 10 cm, where 1 mm is left
    # φ is 0.9 at the layer: 1.9 inside it, and −0.1 beyond it counts as −¼
    layer = np.unravel_index(other.cut_links.voxels, voxmap.grid.shape)[0]
    for k, factor in ((5, 1.0 - 0.9 / 1.9), (7, 1.0 + 0.9 / 0.25)):
        np.testing.assert_allclose(other.cut_links.factors[layer == k], factor)


def test_nothing_flows_out_of_a_steep_surface():
    """A link along θ whose ends are both outside, the layer's end further."""
    region = np.array([1, 1, 0, -1, -1])[:, None, None] * np.ones((1, 3, 1), np.int8)
    region[2, 1] = -1
    place = np.array([[1.1], [1.4], [1.5]])  # φ = −0.9, −0.6 and −0.5 at layer 2
    links = CutLinks.of(region.astype(np.int8), place)
    along = (links.axes == 1) & (
        links.voxels == np.ravel_multi_index((2, 1, 0), (5, 3, 1))
    )
    found = dict(zip(links.neighbours[along] % 3, links.factors[along], strict=True))
    assert found == {0: 0.0, 2: pytest.approx(1.0 - 0.5 / 0.6)}


def test_a_staircase_cuts_none():
    assert len(tube(0.094, "staircase").cut_links.voxels) == 0
