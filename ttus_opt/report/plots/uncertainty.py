"""Plot of the model's uncertainty over the skin, with the measured places."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.plots.canvas import look, new_figure
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap

_SHADES = "cividis"  # uniform in greyscale too


def uncertainty_picture(
    chart: UncertaintyMap, measured: Trajectory | None = None
) -> Figure:
    """Draw a map of uncertainty over the unrolled skin.

    Args:
        chart: The map.
        measured: Recordings that were fitted, drawn as dots.

    Returns:
        A figure of the relative standard deviation of a press's force in percent, over
        angle and height.
    """
    with look():
        figure = new_figure(7.0, 4.5)
        axes = figure.subplots()
        closed = np.concatenate([chart.relative, chart.relative[:1]])
        angles = np.degrees(np.append(chart.theta, 2.0 * np.pi))
        shown = axes.pcolormesh(
            angles, 100.0 * chart.z, 100.0 * closed.T, cmap=_SHADES, shading="gouraud"
        )
        figure.colorbar(shown, ax=axes, label="standard deviation of a press [%]")
        if measured is not None:
            x, y, z = measured.position.T
            around = np.degrees(np.arctan2(y, x)) % 360.0
            axes.plot(around, 100.0 * z, ".", ms=2, color="white")
            axes.set_title("white: recorded")
        axes.set(xlim=(0.0, 360.0), xlabel="θ [°]", ylabel="z [cm]")
        axes.set_xticks(np.arange(0, 361, 60))
        axes.set_ylim(100.0 * chart.z[0], 100.0 * chart.z[-1])
    return figure
