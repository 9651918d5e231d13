"""Colours of numbers, and the legends that tell them."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array

if TYPE_CHECKING:
    from ttus_opt.viewer.colouring import Colouring
    from ttus_opt.viewer.section import Section

Pixels = NDArray[np.uint8]

#: Colour maps that stay readable in greyscale and to the colour-blind
SKIN_MAP, SECTION_MAP = "viridis", "YlGnBu"

#: Skin without a number; classes: filled in, seen
UNKNOWN, CLASSES = (196, 190, 184), ((222, 165, 120), (126, 172, 206))

#: Numbered places on the skin
MARK = (208, 49, 45)

#: Isolines of a section
LINE = (40, 60, 90)

#: Colours of forces: measured, rendered by the first field and by the second
MEASURED, RENDERED = (150, 150, 150), ((208, 49, 45), (124, 58, 190))


def colours(values: Array, span: tuple[float, float], name: str) -> Pixels:
    """Colours of numbers.

    Args:
        values: Any shape; NaN becomes `UNKNOWN`.
        span: Numbers at both ends of the scale.
        name: Colour map.

    Returns:
        One more axis, red, green and blue.
    """
    import matplotlib  # takes a while to load: the page is up before

    low, high = span
    share = np.clip((values - low) / max(high - low, np.finfo(float).tiny), 0.0, 1.0)
    out = matplotlib.colormaps[name](np.nan_to_num(share), bytes=True)[..., :3]
    out = np.ascontiguousarray(out)
    out[np.isnan(values)] = UNKNOWN
    return np.asarray(out, dtype=np.uint8)


def node_colours(colouring: Colouring, span: tuple[float, float]) -> Pixels:
    """Colour of every node of the skin, shape (n, 3).

    Args:
        colouring: The numbers.
        span: Numbers at both ends of the scale.
    """
    if colouring.classes:
        return np.asarray(np.array(CLASSES, np.uint8)[colouring.values.astype(int)])
    return colours(colouring.values, span, SKIN_MAP)


def section_pixels(section: Section) -> Pixels:
    """Picture of a section, transparent beyond it, shape (rows, columns, 4)."""
    out = np.zeros((*section.values.shape, 4), dtype=np.uint8)
    out[..., :3] = colours(section.values, (0.0, section.top), SECTION_MAP)
    out[section.isolines, :3] = LINE
    out[..., 3] = np.where(np.isfinite(section.values), 255, 0)
    return out


def skin_legend(colouring: Colouring, span: tuple[float, float]) -> str:
    """The legend of a colouring, as HTML."""
    if colouring.classes:
        return _swatches(dict(zip(colouring.classes, CLASSES, strict=True)))
    low, high = span
    unknown = np.isnan(colouring.values).any()
    rest = {"not known here": UNKNOWN} if unknown else {}
    if len(colouring.marks):
        rest[f"1 to {len(colouring.marks)}: press here next"] = MARK
    bar = _bar(colouring.title, colouring.unit, low, high, SKIN_MAP)
    return bar + (_swatches(rest) if rest else "")


def section_legend(section: Section, unit: str) -> str:
    """The legend of a section, as HTML."""
    lines = f"potential p, a line every {section.step:g} {unit}"
    return _bar(lines, unit, 0.0, section.top, SECTION_MAP)


def hexadecimal(colour: tuple[int, int, int]) -> str:
    """A colour as HTML writes it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _bar(title: str, unit: str, low: float, high: float, name: str) -> str:
    steps = colours(np.linspace(0.0, 1.0, 9), (0.0, 1.0), name).tolist()
    stops = ",".join(hexadecimal(tuple(step)) for step in steps)
    middle = 0.5 * (low + high)
    marks = "".join(f"<span>{v:.3g}</span>" for v in (low, middle, high))
    return (
        f'<div style="font-size:12px;padding:2px 12px">{escape(title)}'
        f' [{escape(unit)}]<div style="height:10px;border-radius:3px;'
        f'background:linear-gradient(90deg,{stops})"></div>'
        f'<div style="display:flex;justify-content:space-between">{marks}</div></div>'
    )


def _swatches(named: dict[str, tuple[int, int, int]]) -> str:
    boxes = "".join(
        f'<span style="margin-right:12px"><span style="display:inline-block;width:10px;'
        f'height:10px;border-radius:3px;background:{hexadecimal(colour)}"></span> '
        f"{escape(word)}</span>"
        for word, colour in named.items()
    )
    return f'<div style="font-size:12px;padding:2px 12px 10px">{boxes}</div>'
