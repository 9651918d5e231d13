"""Sections against the field's own voxels and an analytic field."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import torso
from tests.viewer.conftest import field
from ttus_opt.viewer.section import sampled, section


def test_samples_at_the_voxels_are_the_field():
    grid = field().voxmap.grid
    i, j, k = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    r, theta, z = grid.r[i], grid.theta[j], grid.z[k]
    points = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1)
    inside = points.reshape(-1, 3) * [1.0, 1.0, 1.0]
    values = sampled(field(), inside)
    known = np.isfinite(values)  # rounding puts some just beyond the grid
    assert known.mean() > 0.8
    expected = field().values.reshape(-1)
    np.testing.assert_allclose(values[known], expected[known], atol=1e-9)


@pytest.mark.parametrize(("direction", "at"), [("axial", 0.11), ("along", 0.7)])
def test_a_section_shows_an_analytic_field(direction, at):
    cylinder = tt.Surface.from_radius(np.full((360, 5), 0.1), np.linspace(0.0, 0.3, 5))
    voxmap = tt.Voxmap.from_surface(cylinder, shape=(41, 60, 31), r_inner=0.02)
    grid = voxmap.grid
    r, z = grid.r[:, None, None], grid.z[None, None, :]
    values = 10.0 * (0.1 - r) + 3.0 * z + 0.0 * grid.theta[None, :, None]
    found = section(tt.PotentialField(voxmap, values, "trilinear"), direction, at)
    rows, columns = found.values.shape
    u = (np.arange(columns) + 0.5) / columns * found.size[0] - found.size[0] / 2
    v = found.size[1] / 2 - (np.arange(rows) + 0.5) / rows * found.size[1]
    u, v = np.meshgrid(u, v)
    r, z = (np.hypot(u, v), at) if direction == "axial" else (np.abs(u), v + 0.15)
    expected = np.broadcast_to(10.0 * (0.1 - r) + 3.0 * z, u.shape)
    expected = np.minimum(expected, 10.0 * 0.08 + 3.0 * z)  # as on the inner layer
    inside = r < 0.099
    assert np.isfinite(found.values[inside]).all()
    np.testing.assert_allclose(found.values[inside], expected[inside], atol=1e-6)
    assert np.isnan(found.values[r > 0.1005]).all()
    np.testing.assert_allclose(found.normal @ found.up, 0.0, atol=1e-15)


def test_isolines_lie_where_the_field_passes_their_values():
    found = section(field(), "axial", 0.1)
    lines = found.isolines
    assert 0.005 < lines.mean() < 0.2
    rows, columns = np.indices(lines.shape)
    pixel = found.size[0] / lines.shape[1]
    r = pixel * np.hypot(rows - lines.shape[0] / 2, columns - lines.shape[1] / 2)
    off = found.values[lines & (r > 0.03)] / found.step
    # a sample on a line is within a pixel of a whole number of steps
    slope = 200.0 * 2.0 * pixel * 1.6 / found.step
    assert np.abs(off - np.round(off)).max() < slope
    assert 4.0 <= found.top / found.step <= 10.0


def test_beyond_a_sector_there_is_no_field():
    voxmap = tt.Voxmap.from_surface(
        torso(), shape=(24, 24, 20), r_inner=0.03, sector=(0.5, 2.6)
    )
    depth = voxmap.spoke_radius[None] - voxmap.grid.r[:, None, None]
    one = tt.PotentialField(voxmap, np.where(voxmap.region == 0, 0, depth), "trilinear")
    angle = np.array([0.51, 1.0, 2.59, 0.4, 2.7, 4.0])
    points = np.stack([0.06 * np.cos(angle), 0.06 * np.sin(angle), 0 * angle + 0.1], 1)
    known = np.isfinite(sampled(one, points))
    np.testing.assert_array_equal(known, [True, True, True, False, False, False])
    assert (sampled(one, points)[:3] > 0.0).all()
