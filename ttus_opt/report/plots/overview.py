"""The method in one picture: scan and surface, potential, force on new motion."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from ttus_opt.core.arrays import Array
from ttus_opt.report.metrics import Evaluation
from ttus_opt.report.plots.canvas import look, new_figure
from ttus_opt.report.plots.forces import draw_magnitude
from ttus_opt.report.plots.potential import UNITS, colour_limit, draw_slice
from ttus_opt.report.plots.surface import draw_section
from ttus_opt.voxmap.field import PotentialField


def overview(
    field: PotentialField, cloud: Array, evaluations: Mapping[str, Evaluation]
) -> Figure:
    """Draw scan and surface, the fitted potential and the rendered force side by side.

    Args:
        field: The fitted field, whose surface was extracted from ``cloud``.
        cloud: The scan, shape (n, 3) [m].
        evaluations: Evaluations on an unseen trajectory, before and after fitting.
    """
    surface, grid = field.voxmap.surface, field.voxmap.grid
    k = grid.shape[2] // 2
    values = field.values[:, :, k]
    with look():
        figure = new_figure(9.8, 3.0, margins=(0.65, 0.22, 0.75, 0.25))
        columns = {"width_ratios": (1.0, 1.25, 1.9), "wspace": 0.42}
        scan, slice_, force = figure.subplots(1, 3, gridspec_kw=columns)
        draw_section(scan, surface, float(grid.z[k]), surface.axis.to_patient(cloud))
        scan.set_title("scan → surface")
        limit = colour_limit(field, k)
        mesh = draw_slice(slice_, field, values, k, limit)
        bar = figure.colorbar(mesh, ax=slice_, fraction=0.046, pad=0.04)
        bar.set_label(f"p [{UNITS[field.unit]}]", labelpad=-4)
        bar.set_ticks([-limit, 0.0, limit])
        slice_.set_title("surface, wrenches → potential")
        for ax in (scan, slice_):
            ax.set_xlabel("x [cm]")
            ax.set_ylabel("y [cm]")
        draw_magnitude(force, evaluations)
        force.set_title("potential → force, unseen motion")
        force.set_xlabel("time [s]")
        force.set_ylim(top=1.2 * force.get_ylim()[1])
        force.legend(loc="upper right", ncols=3, columnspacing=1.0, handlelength=1.6)
        figure.legend(*scan.get_legend_handles_labels(), loc="lower left", ncols=4)
    return figure
