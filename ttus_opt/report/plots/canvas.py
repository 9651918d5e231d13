"""What all pictures share: a figure without global state, its look, its file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from ttus_opt import io
from ttus_opt.errors import InputError

SUFFIXES = (".png", ".pdf", ".svg")

#: Dots per inch of a PNG.
DPI = 100

#: Inks that stay apart in greyscale: what was measured, before, after.
MEASURED, BEFORE, AFTER = "0.72", "0.25", "#0b4f9c"

_LOOK = {
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


def new_figure(width: float, height: float, **layout: Any) -> Figure:
    """An empty figure.

    Args:
        width: [in].
        height: [in].
        layout: Further arguments of the constrained layout.
    """
    engine = ConstrainedLayoutEngine(**layout)
    figure = Figure(figsize=(width, height), dpi=DPI, layout=engine)
    FigureCanvasAgg(figure)
    return figure


def look() -> Any:
    """A context in which axes get the pictures' look."""
    return matplotlib.rc_context(_LOOK)


def require_picture_suffix(path: str | os.PathLike[str]) -> None:
    """Check a picture's file name before the work that leads to it.

    Raises:
        InputError: Not one of `SUFFIXES`.
    """
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(
            f"picture {os.fspath(path)}: the name must end in {', '.join(SUFFIXES)}"
        )


def save_picture(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure, replacing ``path`` only on success.

    Raises:
        InputError: A suffix that is not one of `SUFFIXES`.
        FileError: The folder cannot be written to.
    """
    require_picture_suffix(path)
    with look(), io.replacing(path) as temporary:
        engine = figure.get_layout_engine()
        if engine is not None:
            engine.execute(figure)
            figure.set_layout_engine("none")
        if Path(path).suffix.lower() == ".png" and figure.dpi == DPI:
            # savefig would draw all a second time to look for a tight frame
            FigureCanvasAgg(figure).print_png(temporary)
        else:
            figure.savefig(temporary, dpi=DPI)
