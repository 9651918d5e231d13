"""The README's picture shows scan, potential and unseen forces as they are."""

import importlib
from dataclasses import replace

import numpy as np
from matplotlib.cm import ScalarMappable
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.report.plots.drawn import lines

module = importlib.import_module("ttus_opt.report.plots.overview")


def test_each_part_shows_what_was_given(fields, evaluations, monkeypatch):
    """The scan comes in its own frame, the slice from mid-height."""
    turn = Rotation.from_rotvec([0.3, -0.2, 1.0]).as_matrix()
    axis = tt.Axis(np.array([0.1, -0.2, 1.5]), turn)
    turned = replace(fields[1].voxmap.surface, axis=axis)
    voxmap = tt.Voxmap.from_surface(turned, shape=fields[1].voxmap.grid.shape)
    field = tt.PotentialField(voxmap, fields[1].values, "trilinear")
    grid, drawn = voxmap.grid, {}
    k = grid.shape[2] // 2

    def slice_of(axes, of, values, at, _):
        drawn["slice"] = of, values, at
        return ScalarMappable()

    def section_of(axes, surface, z, cloud):
        drawn["section"] = surface, z, cloud

    monkeypatch.setattr(module, "draw_slice", slice_of)
    monkeypatch.setattr(module, "draw_section", section_of)
    points = np.random.default_rng(0).normal(0.0, 0.1, (50, 3))
    figure = module.overview(field, axis.to_scan(points), evaluations)
    of, values, at = drawn["slice"]
    assert of is field and at == k
    np.testing.assert_array_equal(values, field.values[:, :, k])
    surface, z, cloud = drawn["section"]
    assert surface is voxmap.surface and z == grid.z[k]
    np.testing.assert_allclose(cloud, points, atol=1e-12)
    assert figure.axes[3].get_ylabel() == "p [N/cm²]"
    force, fitted = figure.axes[2], evaluations["fitted"]
    shown = lines(force)
    np.testing.assert_allclose(
        shown["fitted"][1], np.linalg.norm(fitted.rendered_force, axis=1)
    )
    measured = np.linalg.norm(fitted.measured_force, axis=1)
    np.testing.assert_allclose(shown["measured"][1], measured)
    assert force.get_ylim()[1] > max(measured)
