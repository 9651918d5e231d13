"""Plots of the model's uncertainty: over the skin, and against the errors made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.calibration_curve import CalibrationCurve
from ttus_opt.report.plots.canvas import (
    AFTER,
    BEFORE,
    DASHES,
    SHADES,
    few_log_ticks,
    look,
    new_figure,
    unroll,
)
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap

if TYPE_CHECKING:
    from ttus_opt.fitting.uncertainty.next_press import NextPresses


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
            angles, 100.0 * chart.z, 100.0 * closed.T, cmap=SHADES, shading="gouraud"
        )
        figure.colorbar(shown, ax=axes, label="standard deviation of a press [%]")
        if measured is not None:
            _draw_recorded(axes, measured)
            axes.set_title("white: recorded")
        unroll(axes)
        axes.set_ylabel("z [cm]")
        axes.set_ylim(100.0 * chart.z[0], 100.0 * chart.z[-1])
    return figure


#: Coverage that the 95 % interval is asked to have [–]
ASKED = (0.90, 0.98)

#: Shades that tell recordings apart in greyscale, beside their dashes
_GREYS = (AFTER, BEFORE, "#b5651d", "0.55")


def calibration_picture(curves: Mapping[str, CalibrationCurve]) -> Figure:
    """Draw how well stated standard deviations agree with errors.

    Args:
        curves: Of recordings that were not fitted, by name.

    Returns:
        A figure with the share of force components within each central interval on the
        left, over the share stated, and on the right the error made over the standard
        deviation stated, in groups of frames. Both should follow the diagonal.

    Raises:
        InputError: There is no curve.
    """
    if not curves:
        raise InputError("no recording has a stated uncertainty: nothing to draw")
    with look():
        figure = new_figure(9.6, 3.4)
        left, right = figure.subplots(1, 2)
        _grey_diagonal(left, 0.0, 100.0)
        asked = [100.0 * c for c in ASKED]
        left.plot([95.0, 95.0], asked, color="0.8", lw=6.0, label="asked for")
        pairs = [(c.stated_N, c.error_N) for c in curves.values()]
        ends = np.concatenate([np.concatenate(pair) for pair in pairs])
        ends = ends[ends > 0.0]
        low, high = (ends.min(), ends.max()) if ends.size else (0.1, 1.0)
        _grey_diagonal(right, 0.8 * low, 1.25 * high)
        for k, (name, curve) in enumerate(curves.items()):
            style = {
                "color": _GREYS[k % len(_GREYS)],
                "linestyle": DASHES[(k // len(_GREYS)) % len(DASHES)],
            }
            label = f"{name}: {100.0 * curve.coverage:.0f} %"
            left.plot(100.0 * curve.level, 100.0 * curve.force, label=label, **style)
            right.plot(curve.stated_N, curve.error_N, marker="o", ms=3.5, **style)
        left.set(xlim=(0.0, 100.0), ylim=(0.0, 100.0))
        left.set(xlabel="stated share of force components [%]", ylabel="found [%]")
        right.set(xscale="log", yscale="log")
        for axis in (right.xaxis, right.yaxis):
            few_log_ticks(axis)
        right.set(xlabel="stated standard deviation of force [N]", ylabel="error [N]")
        # both panels have the diagonal and the recordings
        drawn = left.get_legend_handles_labels()
        words = {"loc": "outside right center", "title": "in the 95 % interval"}
        figure.legend(*drawn, **words)
    return figure


def _grey_diagonal(axes: Any, low: float, high: float) -> None:
    axes.plot(
        [low, high], [low, high], color="0.6", lw=1.0, zorder=0, label="as stated"
    )


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
                columns, lines, shades, cmap=SHADES, vmin=0.0, vmax=top, alpha=pale
            )
            unroll(axes)
            axes.set_title(title)
        both[0].set_ylabel("z [cm]")
        if measured is not None:
            _draw_recorded(both[0], measured)
            both[0].set_title("before the presses; white: recorded")
        for k, i in enumerate(presses.node.tolist()):
            for axes in both:
                at = degrees[i], heights[i]
                axes.plot(*at, "o", ms=11, color="white", mec="black")
                axes.annotate(str(k + 1), at, ha="center", va="center", fontsize=8)
        figure.colorbar(shown, ax=both, label="standard deviation of a press [N]")
    return figure


def _draw_recorded(axes: Any, measured: Trajectory) -> None:
    x, y, z = measured.position.T
    around = np.degrees(np.arctan2(y, x)) % 360.0
    axes.plot(around, 100.0 * z, ".", ms=2, color="white")


def _regular(values: Array) -> tuple[Array, NDArray[np.int64]]:
    """Evenly spaced values, of which some are given, and the place of each."""
    given = np.unique(values.round(6))
    step = float(np.diff(given).min()) if len(given) > 1 else 1.0
    place = np.rint((values - given[0]) / step).astype(np.int64)
    return given[0] + step * np.arange(place.max() + 1), place
