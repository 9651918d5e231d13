"""HTML that shows an object in a notebook: a title, a few facts, a picture or a table.

Pictures are SVG or PNG of a few hundred bytes, written without a plotting package.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np

from ttus_opt.core.arrays import Array

#: Width and height of a picture [px]
SIZE = 160


def card(title: str, facts: Mapping[str, str], picture: str) -> str:
    """A picture beside a title and a table of facts.

    Args:
        title: Name of the object.
        facts: Text of each value by name.
        picture: HTML of a picture, from `sections_svg` or `signed_map`.
    """
    rows = "".join(
        f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>"
        for name, value in facts.items()
    )
    return (
        f'<div style="display:flex;gap:1em;align-items:center">{picture}'
        f"<div><b>{escape(title)}</b><table>{rows}</table></div></div>"
    )


def page(title: str, lines: Iterable[str], *parts: str) -> str:
    """A title and lines of text above other parts, which are HTML already."""
    text = "<br>".join(escape(line) for line in lines)
    return f"<div><b>{escape(title)}</b><br>{text}{''.join(parts)}</div>"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of text."""
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(entry)}</td>" for entry in row) + "</tr>"
        for row in rows
    )
    return f"<table><tr>{top}</tr>{body}</table>"


def sections_svg(
    outlines: Iterable[Array], circles: Iterable[float] = (), dots: Array | None = None
) -> str:
    """Cross-sections seen along the z axis.

    Args:
        outlines: Closed curves, x and y, shape (n, 2) each [m].
        circles: Radii of dashed circles about the axis [m].
        dots: Points, shape (k, 2) [m].
    """
    curves, rings = list(outlines), list(circles)
    reach = 1.05 * max([*(float(np.abs(c).max()) for c in curves), *rings])
    shapes = [
        f'<circle r="{r:.3f}" stroke="#999" stroke-dasharray=".01"/>' for r in rings
    ]
    for n, curve in enumerate(curves):
        path = " ".join(f"{x:.3f},{-y:.3f}" for x, y in curve)
        shade = 30 + 40 * n / len(curves)
        shapes.append(f'<polygon points="{path}" stroke="hsl(210,60%,{shade:.0f}%)"/>')
    for x, y in () if dots is None else dots:
        shapes.append(
            f'<circle cx="{x:.3f}" cy="{-y:.3f}" r="{0.012 * reach:.4f}" fill="#c33"/>'
        )
    return (
        f'<svg width="{SIZE}" height="{SIZE}" fill="none" stroke-width="{reach / 80}"'
        f' viewBox="{-reach} {-reach} {2 * reach} {2 * reach}">{"".join(shapes)}</svg>'
    )


def curve_svg(time: Array, values: Array) -> str:
    """A curve over time from zero upwards, as wide and high as the picture.

    Args:
        time: Increasing, shape (n,) [s].
        values: At least 0, shape (n,).
    """
    across = (time - time[0]) / max(float(np.ptp(time)), np.finfo(float).tiny)
    up = values / max(float(values.max()), np.finfo(float).tiny)
    path = " ".join(
        f"{SIZE * x:.1f},{SIZE * (1 - 0.95 * y):.1f}"
        for x, y in zip(across, up, strict=True)
    )
    return (
        f'<svg width="{SIZE}" height="{SIZE}" fill="none" stroke="hsl(210,60%,40%)">'
        f'<polyline points="{path}"/></svg>'
    )


def signed_map(values: Array) -> str:
    """An array (rows, columns) as an image, red above zero and blue below."""
    from PIL import Image  # only in a notebook

    most = max(float(np.abs(values).max()), np.finfo(float).tiny)
    share = np.clip(values / most, -1.0, 1.0)
    pale = 1.0 - np.abs(share)
    red, blue = np.where(share > 0, 1.0, pale), np.where(share < 0, 1.0, pale)
    pixels = (255 * np.stack([red, pale, blue], axis=-1)).astype(np.uint8)
    Image.fromarray(pixels).save(png := io.BytesIO(), "PNG")
    data = base64.b64encode(png.getvalue()).decode()
    return (
        f'<img width="{SIZE}" height="{SIZE}" style="image-rendering:pixelated" '
        f'src="data:image/png;base64,{data}"/>'
    )
