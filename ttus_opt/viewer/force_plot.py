"""Plots of force or torque over time, as uPlot takes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ttus_opt.viewer.colour_map import MEASURED, RENDERED, hexadecimal
from ttus_opt.viewer.looks import run_on_pages

#: Height of a plot [px]
HEIGHT = 150

#: The chart's own callbacks cannot be set from Python: this one sets the input that
#: holds the frame, as if it had been typed
ON_CLICK = """
(() => {
  const plot = "%s", input = "%s";
  const listen = () => {
    const chart = window.__viserTestpoints?.uplots?.[plot]?.chart;
    if (!chart || chart.over.dataset.goes) return;
    chart.over.dataset.goes = "1";
    chart.over.style.cursor = "pointer";
    chart.over.addEventListener("click", () => {
      const slider = document.getElementById(input)?.parentElement;
      const field = slider?.querySelector("input:not([type=hidden])");
      const frame = chart.cursor.idx;
      if (!field || frame == null) return;
      const set = Object.getOwnPropertyDescriptor(
        HTMLInputElement.prototype, "value").set;
      set.call(field, String(frame));
      field.dispatchEvent(new Event("input", { bubbles: true }));
    });
  };
  setInterval(listen, 500);
})();
"""


def series(
    names: Sequence[str], *, measured: bool = False, marker: bool = False
) -> Any:
    """Time, then the measured force, every field's and the present frame's."""
    out: list[dict[str, Any]] = [{"label": "t [s]"}]
    line = {"points": {"show": False}}
    if measured:
        grey = hexadecimal(MEASURED)
        out.append({"label": "measured", "stroke": grey, "width": 2.5, **line})
    out += [
        {"label": name, "stroke": hexadecimal(colour), "width": 1.5, **line}
        for name, colour in zip(names, RENDERED, strict=False)
    ]
    if marker:
        points = {"show": True, "size": 9, "fill": "#111"}
        out.append({"label": "now", "stroke": "#111", "width": 0, "points": points})
    return tuple(out)


def add_plot(
    gui: Any,
    columns: Any,
    told: Any,
    span: tuple[float, float] | None = None,
    quantity: str = "force [N]",
) -> Any:
    """A plot of columns, the first of which is time, over a span of the quantity."""
    upright = {"auto": True} if span is None else {"range": span}
    small = {"font": "11px sans-serif", "labelFont": "11px sans-serif", "labelSize": 14}
    return gui.add_uplot(
        columns,
        told,
        axes=tuple(
            {**small, "size": size, "label": label}
            for size, label in ((24, "time [s]"), (36, quantity))
        ),
        scales={"x": {"time": False, "auto": True}, "y": upright},
        legend={"show": False},  # the numbers above have the colours
        height=HEIGHT,
        cursor={"drag": {"x": False, "y": False}},
    )


def go_on_click(server: Any, plot: Any, frame: Any) -> None:
    """Let a click on a plot set the input that holds the frame, on every page."""
    run_on_pages(server, ON_CLICK % (plot._impl.uuid, frame._impl.uuid))
