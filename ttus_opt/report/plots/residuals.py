"""Histograms of rendered minus measured wrenches, before and after fitting."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ttus_opt.core.arrays import Array
from ttus_opt.report.metrics import Evaluation
from ttus_opt.report.plots.canvas import AFTER, BEFORE, look, new_figure


def residual_histogram(
    before: Sequence[Evaluation], after: Sequence[Evaluation]
) -> Figure:
    """Histograms of the residual components, rendered minus measured.

    Args:
        before: Evaluations of the Laplace field alone.
        after: Evaluations of the fitted field on the same trajectories.

    Returns:
        A figure with forces [N] on the left and torques [mN m] on the right.
    """
    with look():
        figure = new_figure(7.2, 3.1, margins=(0.61, 0.06, 0.96, 0.06))
        left, right = figure.subplots(1, 2, gridspec_kw={"wspace": 0.13})
        _draw(left, [_force(e) for e in before], [_force(e) for e in after], "N")
        left.set_xlabel("force residual, each component [N]")
        left.set_ylabel("share of residuals [%]")
        _draw(right, [_torque(e) for e in before], [_torque(e) for e in after], "mN m")
        right.set_xlabel("torque residual, each component [mN m]")
    return figure


def _force(evaluation: Evaluation) -> Array:
    return (evaluation.rendered_force - evaluation.measured_force).reshape(-1)


def _torque(evaluation: Evaluation) -> Array:
    residual = evaluation.rendered_torque - evaluation.measured_torque
    return 1e3 * residual.reshape(-1)


def _draw(
    axes: Any, before: Sequence[Array], after: Sequence[Array], unit: str
) -> None:
    first, second = np.concatenate(before), np.concatenate(after)
    reach = float(np.percentile(np.abs(np.concatenate([first, second])), 99.5)) or 1.0
    edges = np.linspace(-reach, reach, 42)
    for values, label, style in (
        (first, "Laplace alone", {"color": BEFORE, "hatch": "//////", "fill": False}),
        (second, "fitted", {"color": AFTER, "linewidth": 1.6, "fill": False}),
    ):
        share = 100.0 * np.histogram(values, edges)[0] / len(values)
        rms = float(np.sqrt((values**2).mean()))
        axes.stairs(share, edges, label=f"{label}: rms {rms:.2f} {unit}", **style)
    axes.axvline(0.0, color="0.6", linewidth=0.6, zorder=0)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.22))
    axes.margins(x=0.0)
    axes.locator_params(axis="x", nbins=6)
