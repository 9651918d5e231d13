"""The README's picture shows scan, potential and unseen forces as they are."""

from __future__ import annotations

import numpy as np

from tests.report.plots.drawn import lines
from ttus_opt.report import plots
from ttus_opt.report.metrics import Evaluation
from ttus_opt.report.plots.potential import colour_limit
from ttus_opt.voxmap.field import PotentialField


def test_each_part_shows_what_was_given(
    fields: tuple[PotentialField, PotentialField], evaluations: dict[str, Evaluation]
) -> None:
    field = fields[1]
    surface, grid = field.voxmap.surface, field.voxmap.grid
    middle = grid.z[grid.shape[2] // 2]
    # a ring of points about the middle slice, in the scan's frame
    theta = np.linspace(0.0, 6.2, 50)
    ring = np.stack([0.1 * np.cos(theta), 0.1 * np.sin(theta), 0 * theta + middle], 1)
    cloud = surface.axis.to_scan(ring)
    scan, potential, force = plots.overview(field, cloud, evaluations).axes[:3]
    shown = [
        np.column_stack([np.asarray(line.get_xdata()), np.asarray(line.get_ydata())])
        for line in scan.lines
    ]
    shown += [np.asarray(part.get_offsets()) for part in scan.collections]
    near = [
        part
        for part in shown
        if len(part) == 50 and np.allclose(np.sort(part), np.sort(100.0 * ring[:, :2]))
    ]
    assert len(near) == 1
    filled = potential.collections[0]
    k = grid.shape[2] // 2
    assert filled.norm.vmax <= 1.2 * colour_limit(field, k)
    drawn = lines(force)
    fitted = evaluations["fitted"]
    np.testing.assert_allclose(
        drawn["fitted"][1], np.linalg.norm(fitted.rendered_force, axis=1)
    )
    measured = np.linalg.norm(fitted.measured_force, axis=1)
    np.testing.assert_allclose(drawn["measured"][1], measured)
    assert force.get_ylim()[1] > max(measured)
