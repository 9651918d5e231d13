"""The numbers of a touch as HTML: force, torque, contact, and what limits them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.viewer.colour_map import MEASURED, RENDERED, hexadecimal
from ttus_opt.viewer.touch import Touch

#: Begins a table of numbers
TABLE = '<table style="width:100%;font-size:13px;font-variant-numeric:tabular-nums">'

#: Room for a note of two lines: the buttons below do not move as it comes and goes [px]
NOTES = 42

#: Words for where the pose comes from
SOURCES = {
    "hand": "moved by hand",
    "recording": "a recorded pose",
    "outside": "followed from outside",
}


def readout(
    touches: Sequence[Touch], names: Sequence[str], measured: Array | None, source: str
) -> str:
    """A table with a column per field.

    Args:
        touches: What every field gives at the pose.
        names: Of the fields.
        measured: Force measured at the pose, shape (3,) [N], NaN where none was; None
            where there are no measurements at all.
        source: Where the pose comes from.
    """
    if not touches:
        return _note("no probe: give one to press (--probe)", "#777")
    heads = "".join(
        f'<th style="text-align:right;color:{hexadecimal(colour)}">{escape(name)}</th>'
        for name, colour in zip(names, RENDERED, strict=False)
    )
    rows = [_row(*cells) for cells in _rows(touches)]
    if measured is not None:
        grey = hexadecimal(MEASURED)
        rows.insert(1, _row("measured", "N", [_size(measured)], f"color:{grey}"))
    notes = dict.fromkeys(note for touch in touches for note in touch.notes)
    table = (
        f'{TABLE}<tr><td style="color:#777">{SOURCES[source]}</td>{heads}<td></td></tr>'
        f"{''.join(rows)}</table>"
    )
    told = "".join(_note(note, "#b45309") for note in notes)
    return (
        f'<div style="padding:2px 12px 8px">{table}'
        f'<div style="min-height:{NOTES}px">{told}</div></div>'
    )


def _rows(touches: Sequence[Touch]) -> list[tuple[str, str, list[str]]]:
    wrenches = [touch.wrench for touch in touches]
    rows = [
        ("force", "N", [_size(w.force) for w in wrenches]),
        ("x, y, z", "N", [_vector(w.force, 1.0, 1) for w in wrenches]),
        ("torque", "mN m", [f"{1e3 * np.linalg.norm(w.torque):.0f}" for w in wrenches]),
        ("x, y, z", "mN m", [_vector(w.torque, 1e3, 0) for w in wrenches]),
        ("depth", "mm", [f"{1e3 * touches[0].depth:.1f}"]),
        ("contact", "mm long", [f"{1e3 * touches[0].contact_length:.0f}"]),
    ]
    stds = [w.force_std for w in wrenches]
    if any(math.isfinite(std) for std in stds):
        rows.insert(1, ("±", "N", [f"{std:.2f}" for std in stds]))
    return rows


def _row(name: str, unit: str, cells: Sequence[str], style: str = "") -> str:
    found = "".join(f'<td style="text-align:right">{cell}</td>' for cell in cells)
    return (
        f'<tr style="{style}"><td>{escape(name)}</td>{found}'
        f'<td style="color:#777">{unit}</td></tr>'
    )


def _size(force: Array) -> str:
    size = float(np.linalg.norm(force))
    return f"<b>{size:.2f}</b>" if math.isfinite(size) else "–"


def _vector(values: Array, factor: float, digits: int) -> str:
    rounded = np.round(factor * values, digits) + 0.0  # no −0
    return ", ".join(f"{value:.{digits}f}" for value in rounded.tolist())


def _note(text: str, colour: str) -> str:
    return (
        f'<div style="font-size:12px;color:{colour};border-left:3px solid {colour};'
        f'padding-left:6px;margin-top:4px">{escape(text)}</div>'
    )
