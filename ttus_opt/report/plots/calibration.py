"""Plot of stated uncertainty against the errors that were made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from ttus_opt.core.errors import InputError
from ttus_opt.report.calibration_curve import CalibrationCurve
from ttus_opt.report.plots.canvas import AFTER, BEFORE, look, new_figure

#: Coverage that the 95 % interval is asked to have [–]
ASKED = (0.90, 0.98)

#: Shades and dash patterns that tell recordings apart in greyscale
_SHADES = (AFTER, BEFORE, "#b5651d", "0.55")
_DASHES: tuple[Any, ...] = ("-", (0, (4, 2)), (0, (1, 1)), (0, (5, 1, 1, 1)))


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
                "color": _SHADES[k % len(_SHADES)],
                "linestyle": _DASHES[(k // len(_SHADES)) % len(_DASHES)],
            }
            label = f"{name}: {100.0 * curve.coverage:.0f} %"
            left.plot(100.0 * curve.level, 100.0 * curve.force, label=label, **style)
            right.plot(curve.stated_N, curve.error_N, marker="o", ms=3.5, **style)
        left.set(xlim=(0.0, 100.0), ylim=(0.0, 100.0))
        left.set(xlabel="stated share of force components [%]", ylabel="found [%]")
        right.set(xscale="log", yscale="log")
        for axis in (right.xaxis, right.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(NullFormatter())
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
