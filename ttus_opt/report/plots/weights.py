"""Effect of the weights along a path: L-curve and errors on held-out recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from ttus_opt.core.errors import InputError
from ttus_opt.report.plots.canvas import (
    AFTER,
    BEFORE,
    COLOURS,
    DASHES,
    few_log_ticks,
    look,
    new_figure,
)

if TYPE_CHECKING:
    import xarray as xr

#: Units of the objective, as they are written
_SQUARES = {"N2": " [N²]", "N2 cm-4": " [(N/cm²)²]"}

#: Errors on held-out recordings to draw; over two weights only the first
_HELD_OUT = ("held_out_force_magnitude_error", "held_out_force_angle_error")


def weight_path(path: xr.Dataset, title: str = "") -> Figure:
    """Draw a path of weights from `ttus_opt.solution_path`.

    Args:
        path: A path over one or two weights.
        title: Title of the figure.

    Returns:
        A figure with the L-curve on the left: the cost of the other terms against that
        of the varied ones. On the right are the errors on held-out recordings (without
        any, the residuals of the fitted ones) over the weight or both weights.

    Raises:
        InputError: This is not a path, it has more than two weights, or no point of it
            was solved.
    """
    if "term_value" not in path:
        raise InputError("weight_path takes the result of solution_path")
    dims = [str(dim) for dim in path["status"].dims]
    if len(dims) > 2:
        raise InputError(
            f"a path over {len(dims)} weights cannot be drawn: take a slice of it, "
            f"path.isel({dims[-1]}=0)"
        )
    if bool(path["objective"].isnull().all()):
        raise InputError("no point of the path was solved: there is nothing to draw")
    with look():
        figure = new_figure(8.0, 3.4)
        left, right = figure.subplots(1, 2)
        _draw_l_curve(left, path, dims)
        named = title or str(path.attrs.get("title", ""))
        left.set_title(f"{named}, with some of its weights".removeprefix(", "))
        if len(dims) == 1:
            _draw_errors(right, path, dims[0])
        else:
            _draw_map(figure, right, path, dims)
    return figure


def _draw_l_curve(axes: Any, path: xr.Dataset, dims: Sequence[str]) -> None:
    """Draw the other terms over the varied ones, one line per second weight."""
    varied = [str(name) for name in path.coords if str(name).endswith("_weight")]
    named = [name.removesuffix("_weight") for name in varied]
    terms = [str(term) for term in path["term"].values]
    plain = path["term_value"].sel(term=[t for t in terms if t in named]).sum("term")
    # the other terms are the objective less the weighted varied terms
    paid = sum(
        path[f"{t}_weight"] * path["term_value"].sel(term=t).fillna(0.0)
        for t in terms
        if t in named
    )
    rest = path["objective"] - paid
    lines = (
        [{}] if len(dims) == 1 else [{dims[1]: k} for k in range(path.sizes[dims[1]])]
    )
    for k, at in enumerate(lines):
        shade = str(0.7 * k / max(len(lines) - 1, 1))
        colour = AFTER if len(dims) == 1 else shade
        x, y = plain.isel(at).to_numpy(), rest.isel(at).to_numpy()
        (line,) = axes.loglog(x, y, color=colour, marker=".", linewidth=1.1)
        if len(dims) > 1:
            line.set_label(_short(path[dims[1]][k]))
        if k == 0:
            _write_weights(axes, x, y, path[dims[0]].to_numpy())
    measured = " [N²]" * ({*named} <= {"force", "torque"})  # torque over a length
    axes.set_xlabel(f"{' + '.join(named)}, without weight{measured}")
    unit = _SQUARES.get(str(path["objective"].attrs.get("units")), "")
    axes.set_ylabel(f"all other terms{unit}")
    if len(dims) > 1:
        title = dims[1].replace("_", " ")
        axes.legend(title=title, fontsize=7, title_fontsize=7.5, labelspacing=0.2)
    _few_ticks(axes.xaxis, plain.to_numpy())
    _few_ticks(axes.yaxis, rest.to_numpy())
    axes.grid(color="0.92", linewidth=0.5)


def _few_ticks(axis: Any, values: Any) -> None:
    """Ticks that do not overprint: over less than two decades 1, 2 and 5 of each."""
    known = values[np.isfinite(values) & (values > 0.0)]
    axis.set_minor_formatter(NullFormatter())
    if known.size and known.max() < 100.0 * known.min():
        few_log_ticks(axis)


def _write_weights(axes: Any, x: Any, y: Any, weights: Any) -> None:
    """Write a few weights beside their points."""
    solved = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    for i in solved[np.linspace(0, len(solved) - 1, min(5, len(solved))).astype(int)]:
        axes.annotate(
            _short(weights[i]),
            (x[i], y[i]),
            textcoords="offset points",
            xytext=(4, 4),
            fontsize=7.5,
            color=BEFORE,
        )


def _short(weight: Any) -> str:
    """A weight in two digits: 100, not 1e+02."""
    return f"{float(f'{float(weight):.2g}'):g}"


def _judged(path: xr.Dataset) -> tuple[bool, str, str, str]:
    """Whether recordings were held out; error to draw, its dimension, and a label."""
    if _HELD_OUT[0] in path:
        return True, _HELD_OUT[0], "held_out", "held-out force error [N]"
    return False, "force_residual", "recording", "force residual, rms [N]"


def _draw_errors(axes: Any, path: xr.Dataset, dim: str) -> None:
    """Draw the force error [N] on the left scale and the angle [°] on the right."""
    weights = path[dim].to_numpy()
    held, name, over, title = _judged(path)
    axes.set_xscale("log")
    axes.set_xlabel("weight [–]")
    if name not in path:
        axes.text(
            0.5, 0.5, "nothing was measured", transform=axes.transAxes, ha="center"
        )
        return
    for k, one in enumerate(path[over].values):
        dashes = DASHES[k % len(DASHES)]
        values = path[name].isel({over: k}).to_numpy()
        label = f"{one}, force" if held else f"{one}"
        axes.plot(weights, values, color=AFTER, linestyle=dashes, label=label)
        if held:
            _mark_least(axes, weights, values, first=k == 0)
    axes.set_ylabel(title)
    axes.set_ylim(bottom=0.0)
    lines = axes.get_lines()
    if held:
        second = axes.twinx()
        for k, one in enumerate(path[over].values):
            angle = path[_HELD_OUT[1]].isel({over: k}).to_numpy()
            dashes = DASHES[k % len(DASHES)]
            lines += second.plot(
                *(weights, angle), color="0.6", linestyle=dashes, label=f"{one}, angle"
            )
        second.set_ylabel("held-out force angle [°]")
        second.set_ylim(bottom=0.0)
        second.spines["right"].set_visible(True)
    named = [line for line in lines if not line.get_label().startswith("_")]
    axes.legend(
        handles=named,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=2,
        title=None if held else "recording",
    )


def _mark_least(axes: Any, weights: Any, values: Any, *, first: bool) -> None:
    if np.isfinite(values).any():
        at = int(np.nanargmin(values))
        label = "least" if first else None
        axes.plot(weights[at], values[at], "o", color=AFTER, ms=4.0, label=label)


def _draw_map(figure: Figure, axes: Any, path: xr.Dataset, dims: Sequence[str]) -> None:
    """Draw errors over two weights, averaged over all recordings."""
    _, name, over, label = _judged(path)
    values = path[name].mean(over).transpose(*dims).to_numpy()
    x, y = (np.log10(path[dim].to_numpy()) for dim in dims)
    mesh = axes.pcolormesh(x, y, values.T, cmap=COLOURS, shading="nearest")
    figure.colorbar(mesh, ax=axes).set_label(label)
    if np.isfinite(values).any():
        i, j = np.unravel_index(np.nanargmin(values), values.shape)
        axes.plot(x[i], y[j], "o", color="white", mec="black", ms=5.0, label="least")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0))
    for set_label, dim in ((axes.set_xlabel, dims[0]), (axes.set_ylabel, dims[1])):
        set_label(f"log₁₀ of the {dim.replace('_', ' ')}")
