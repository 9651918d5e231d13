"""Flame graph of a profile, upside down: a row per depth, a bar per span."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ttus_opt.report.plots.canvas import look, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Width of a letter at the font size of the bars, as a part of the picture's width
LETTER = 0.0064

#: Fills by how much of its time a span spends in itself: lightest for none of it
LIGHT, DARK = 0.97, 0.62


def flame_graph(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw spans as bars whose width is their time, children below their parent.

    Args:
        rows: A parent before its children: ``path`` (names from the root), ``own``
            and ``total`` [s].

    Returns:
        The figure. The darker a bar, the more of its time is its own.
    """
    whole = rows[0]["total"]
    depth = max(len(row["path"]) for row in rows)
    with look():
        figure = new_figure(9.0, 0.7 + 0.38 * depth)
        axis = figure.subplots()
        # where the next child of a span begins
        begins: dict[tuple[str, ...], float] = {}
        for row in rows:
            path = tuple(row["path"])
            start = begins.get(path[:-1], 0.0)
            begins[path[:-1]] = start + row["total"]
            begins[path] = start
            own = row["own"] / row["total"] if row["total"] else 0.0
            axis.barh(
                -len(path),
                row["total"],
                left=start,
                height=0.94,
                color=str(LIGHT - (LIGHT - DARK) * own),
                edgecolor="white",
                linewidth=0.6,
            )
            share = row["total"] / whole if whole else 0.0
            text = _fitting(path[-1], share)
            if text:
                axis.text(
                    start + row["total"] / 2.0,
                    -len(path),
                    text,
                    ha="center",
                    va="center",
                    fontsize=7.5,
                )
        axis.set_xlim(0.0, whole)
        axis.set_ylim(-depth - 0.6, -0.4)
        axis.set_yticks([])
        axis.spines["left"].set_visible(False)
        axis.set_xlabel("seconds (bars stand side by side, not in order of time)")
    return figure


def _fitting(name: str, share: float) -> str:
    """As much of the label as the bar has room for."""
    first, _, rest = name.partition(" ")
    for text in (f"{name} {share:.0%}", name, f"{first}\n{rest}"):
        if max(map(len, text.split("\n"))) * LETTER <= share:
            return text
    return ""
