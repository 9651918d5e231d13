"""Rendered against measured force: over time, and what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.report.metrics import Evaluation
from ttus_opt.report.plots.canvas import AFTER, BEFORE, MEASURED, look, new_figure

_LINES = (
    {"color": BEFORE, "linestyle": (0, (4, 2)), "linewidth": 0.9},
    {"color": AFTER, "linestyle": "-", "linewidth": 1.1},
)


def force_over_time(evaluations: Mapping[str, Evaluation], title: str = "") -> Figure:
    """Force magnitude and components, measured and rendered.

    Args:
        evaluations: One or two renderings of the same trajectory by name; the first of
            two is drawn dashed.
        title: Title of the figure.

    Raises:
        InputError: There are none or more than two evaluations, or they are of
            different trajectories.
    """
    first = _checked(evaluations)
    with look():
        figure = new_figure(7.2, 6.0, margins=(0.7, 0.14, 0.45, 0.33))
        rows = {"height_ratios": (1.5, 1, 1, 1), "hspace": 0.13}
        axes = figure.subplots(4, 1, sharex=True, gridspec_kw=rows)
        draw_magnitude(axes[0], evaluations)
        axes[0].set_title(title)
        axes[0].legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
        for i, name in enumerate("xyz"):
            _draw(
                axes[i + 1],
                first.time,
                first.measured_force[:, i],
                {label: e.rendered_force[:, i] for label, e in evaluations.items()},
            )
            axes[i + 1].set_ylabel(f"$f_{name}$ [N]")
            axes[i + 1].axhline(0.0, color="0.85", linewidth=0.6, zorder=0)
        axes[-1].set_xlabel("time [s]")
        figure.align_ylabels(list(axes))
    return figure


def draw_magnitude(axes: Any, evaluations: Mapping[str, Evaluation]) -> None:
    """Draw measured and rendered ‖f‖ into given axes."""
    first = _checked(evaluations)
    _draw(
        axes,
        first.time,
        np.linalg.norm(first.measured_force, axis=1),
        {
            label: np.linalg.norm(e.rendered_force, axis=1)
            for label, e in evaluations.items()
        },
    )
    axes.set_ylabel("‖f‖ [N]")
    axes.set_ylim(bottom=0.0)


def _checked(evaluations: Mapping[str, Evaluation]) -> Evaluation:
    if not 1 <= len(evaluations) <= 2:
        raise InputError(f"give one or two evaluations, got {len(evaluations)}")
    first, *rest = evaluations.values()
    if any(not np.array_equal(e.time, first.time) for e in rest):
        raise InputError(
            "the evaluations belong to different trajectories: draw them separately"
        )
    return first


def _draw(
    axes: Any, time: Array, measured: Array, rendered: Mapping[str, Array]
) -> None:
    clock, breaks = _clock(time)
    # no line joins the end of a recording to the start of the next
    grey = np.insert(measured, breaks, np.nan)
    axes.plot(clock, grey, color=MEASURED, linewidth=3.0, label="measured")
    lines = _LINES[-len(rendered) :]
    for (label, values), line in zip(rendered.items(), lines, strict=True):
        axes.plot(clock, np.insert(values, breaks, np.nan), label=label, **line)
    axes.margins(x=0.01)


def _clock(time: Array) -> tuple[Array, NDArray[np.int64]]:
    """Time with recordings placed one after the other, and where they begin."""
    breaks = np.flatnonzero(np.diff(time) <= 0) + 1
    clock = time.copy()
    for i in breaks:
        clock[i:] += clock[i - 1] + 1.0 - clock[i]
    return np.insert(clock, breaks, np.nan), breaks


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
        for ax, what, factor, unit in (
            (left, "force", 1.0, "N"),
            (right, "torque", 1e3, "mN m"),
        ):
            old, new = (factor * _residuals(e, what) for e in (before, after))
            _draw_shares(ax, old, new, unit)
            ax.set_xlabel(f"{what} residual, each component [{unit}]")
        left.set_ylabel("share of residuals [%]")
    return figure


def _residuals(evaluations: Sequence[Evaluation], what: str) -> Array:
    """Rendered minus measured components of ``force`` or ``torque``, flat."""
    pairs = [
        (getattr(e, f"rendered_{what}"), getattr(e, f"measured_{what}"))
        for e in evaluations
    ]
    return np.concatenate([(a - b).reshape(-1) for a, b in pairs])


def _draw_shares(axes: Any, first: Array, second: Array, unit: str) -> None:
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
