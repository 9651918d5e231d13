"""Shared by all plots: figures without global state, their style, and saving them."""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from ttus_opt.core import io
from ttus_opt.core.errors import InputError

SUFFIXES = (".png", ".pdf", ".svg")

#: Resolution of a PNG [dots per inch]
DPI = 100

#: Colours of measured, before and after, distinguishable in greyscale
MEASURED, BEFORE, AFTER = "0.72", "0.25", "#0b4f9c"

#: Perceptually uniform colours, whose grey rises from the lowest value to the highest
COLOURS = "viridis"

#: The same for what must not look like a potential
SHADES = "cividis"

#: Dash patterns that tell recordings apart in greyscale
DASHES: tuple[Any, ...] = ("-", (0, (4, 2)), (0, (1, 1)), (0, (5, 1, 1, 1)))

_LOOK = {
    "svg.hashsalt": "ttus_opt",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "hatch.linewidth": 0.5,
}


def new_figure(
    width: float,
    height: float,
    margins: tuple[float, float, float, float] | None = None,
) -> Figure:
    """An empty figure.

    Args:
        width: Width [in].
        height: Height [in].
        margins: Left, right, bottom and top margins of its axes [in]. By default they
            are found from the labels, which takes longer than drawing the figure.
    """
    engine = None if margins else ConstrainedLayoutEngine()
    figure = Figure(figsize=(width, height), dpi=DPI, layout=engine)
    FigureCanvasAgg(figure)
    if margins:
        left, right, bottom, top = margins
        figure.subplots_adjust(
            left / width, bottom / height, 1.0 - right / width, 1.0 - top / height
        )
    return figure


def add_axes(
    figure: Figure,
    box: tuple[float, float, float, float],
    projection: str | None = None,
) -> Any:
    """Add axes at a given position.

    Args:
        figure: The figure.
        box: Left, bottom, width and height [in].
        projection: "3d" or None.
    """
    width, height = figure.get_size_inches()
    left, bottom, wide, high = box
    share = (left / width, bottom / height, wide / width, high / height)
    return figure.add_axes(share, projection=projection)


def unroll(axes: Any) -> None:
    """Make axes those of the unrolled skin, θ [°] to the right."""
    axes.set(xlim=(0.0, 360.0), xlabel="θ [°]", xticks=range(0, 361, 60))


def few_log_ticks(axis: Any) -> None:
    """Ticks at 1, 2 and 5 of every decade, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def look() -> Any:
    """A context in which new axes have the style of these plots."""
    return matplotlib.rc_context(_LOOK)


def require_picture_suffix(path: str | os.PathLike[str]) -> None:
    """Check a picture's file name before any work is done.

    Raises:
        InputError: The suffix is not one of `SUFFIXES`.
    """
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(
            f"picture {os.fspath(path)}: the name must end in {', '.join(SUFFIXES)}"
        )


def save_picture(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure, replacing ``path`` only on success.

    Raises:
        InputError: The suffix is not one of `SUFFIXES`.
        FileError: The folder cannot be written to.
    """
    require_picture_suffix(path)
    drawn, suffix = BytesIO(), Path(path).suffix.lower()
    io.check_output(path)
    with look():
        engine = figure.get_layout_engine()
        if engine is not None:
            engine.execute(figure)
            figure.set_layout_engine("none")
        if suffix == ".png" and figure.dpi == DPI:
            # savefig would draw the figure twice to find a tight frame
            FigureCanvasAgg(figure).print_png(drawn)
        else:
            undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
            about = undated.get(suffix)  # the same picture has the same bytes
            figure.savefig(drawn, dpi=DPI, format=suffix[1:], metadata=about)
    io.write_bytes(path, drawn.getvalue())
