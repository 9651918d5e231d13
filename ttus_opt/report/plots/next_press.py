"""Plot of the uncertainty over the skin before and after suggested presses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.plots.canvas import look, new_figure

if TYPE_CHECKING:
    from ttus_opt.fitting.uncertainty.next_press import NextPresses

_SHADES = "cividis"  # uniform in greyscale too


def next_press_picture(
    presses: NextPresses, measured: Trajectory | None = None
) -> Figure:
    """Draw the unrolled skin with the places to press next.

    Args:
        presses: The suggestions.
        measured: Recordings that were fitted, drawn as dots.

    Returns:
        A figure of the standard deviation of a press's normal force over angle and
        height: before the suggested presses, which are numbered, and after them. What
        lies outside the region asked for is pale.
    """
    degrees, heights = np.degrees(presses.theta), 100.0 * presses.z
    columns, column = _regular(degrees)
    lines, line = _regular(heights)
    top = float(presses.before.max())
    with look():
        figure = new_figure(9.0, 4.2)
        both = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, std, title in zip(
            both,
            (presses.before, presses.after),
            ("before the presses", "after them"),
            strict=True,
        ):
            shades = np.full((len(lines), len(columns)), np.nan)
            pale = np.ones_like(shades)
            shades[line, column] = std
            pale[line, column] = np.where(presses.in_region, 1.0, 0.35)
            shown = axes.pcolormesh(
                columns, lines, shades, cmap=_SHADES, vmin=0.0, vmax=top, alpha=pale
            )
            axes.set(title=title, xlabel="θ [°]", xticks=np.arange(0, 361, 60))
            axes.set_xlim(0.0, 360.0)
        both[0].set_ylabel("z [cm]")
        if measured is not None:
            x, y, z = measured.position.T
            around = np.degrees(np.arctan2(y, x)) % 360.0
            both[0].plot(around, 100.0 * z, ".", ms=2, color="white")
            both[0].set_title("before the presses; white: recorded")
        for k, i in enumerate(presses.node.tolist()):
            for axes in both:
                at = degrees[i], heights[i]
                axes.plot(*at, "o", ms=11, color="white", mec="black")
                axes.annotate(str(k + 1), at, ha="center", va="center", fontsize=8)
        figure.colorbar(shown, ax=both, label="standard deviation of a press [N]")
    return figure


def _regular(values: Array) -> tuple[Array, NDArray[np.int64]]:
    """Evenly spaced values, of which some are given, and the place of each."""
    given = np.unique(values.round(6))
    step = float(np.diff(given).min()) if len(given) > 1 else 1.0
    place = np.rint((values - given[0]) / step).astype(np.int64)
    return given[0] + step * np.arange(place.max() + 1), place
