"""Tables of errors before and after fitting, and the report around them."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ttus_opt.core import io
from ttus_opt.report.metrics import Errors, Evaluation


@dataclass(frozen=True)
class Comparison:
    """One recording rendered with two fields.

    Attributes:
        recording: Name of the recording.
        seen: Whether the field was fitted to it.
        before: Evaluation of the Laplace field alone.
        after: Evaluation of the fitted field.
    """

    recording: str
    seen: bool
    before: Evaluation
    after: Evaluation

    def as_dict(self) -> dict[str, Any]:
        """Errors by name, for JSON."""
        return {
            "recording": self.recording,
            "seen": self.seen,
            "before": self.before.errors.as_dict(),
            "after": self.after.errors.as_dict(),
        }


_COLUMNS: tuple[tuple[str, Callable[[Errors], float], str], ...] = (
    ("force [N]", lambda e: e.force_magnitude_error_N, ".2f"),
    ("rmse [N]", lambda e: e.force_magnitude_rmse_N, ".2f"),
    ("angle [°]", lambda e: e.force_angle_error_deg, ".1f"),
    ("torque [mN m]", lambda e: 1e3 * e.torque_magnitude_error_Nm, ".1f"),
    ("angle [°]", lambda e: e.torque_angle_error_deg, ".1f"),
)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table with aligned columns, without a final newline.

    >>> print(table(["a", "number"], [["x", "1"]]))
    | a | number |
    |---|--------|
    | x | 1      |
    """
    lines = [list(header), *map(list, rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    text = [
        "| " + " | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + " |"
        for line in lines
    ]
    text.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    return "\n".join(text)


def error_table(comparisons: Sequence[Comparison]) -> str:
    """Errors before → after and the frames in contact, one row per recording."""
    return table(*error_cells(comparisons))


def error_cells(
    comparisons: Sequence[Comparison],
) -> tuple[list[str], list[list[str]]]:
    """Header and rows of `error_table`."""
    header = ["recording", "frames", *(name for name, _, _ in _COLUMNS)]
    rows = []
    for case in comparisons:
        before, after = case.before.errors, case.after.errors
        kind = "same" if case.seen else "new"
        cells = [f"{case.recording} ({kind})"]
        cells.append(f"{after.frames_in_contact}/{after.frames}")
        cells += [
            f"{number(read(before), form)} → {number(read(after), form)}"
            for _, read, form in _COLUMNS
        ]
        rows.append(cells)
    return header, rows


def errors_by_name(named: Mapping[str, Errors]) -> str:
    """Errors and the frames in contact, one row per name."""
    header = ["", "frames", *(name for name, _, _ in _COLUMNS), "felt [%]"]
    rows = []
    for name, errors in named.items():
        cells = [name, f"{errors.frames_in_contact}/{errors.frames}"]
        cells += [number(read(errors), form) for _, read, form in _COLUMNS]
        rows.append([*cells, number(100.0 * errors.share_told_apart, ".1f")])
    return table(header, rows)


def write_report(
    path: str | os.PathLike[str],
    comparisons: Sequence[Comparison],
    *,
    facts: Mapping[str, str],
    pictures: Mapping[str, str],
) -> None:
    """Write a report in Markdown, replacing ``path`` only on success.

    Args:
        path: The file.
        comparisons: Errors before and after.
        facts: Lines at the beginning of the report, by name.
        pictures: Captions by file name, in order.
    """
    threshold = comparisons[0].after.errors.force_threshold_N
    parts = [
        "# Report",
        "\n".join(f"- {name}: {what}" for name, what in facts.items()),
        "## Errors before → after fitting",
        error_table(comparisons),
        "Before: the Laplace prior alone, its boundary scaled to the measured forces. "
        "After: the fitted field. *Same*: the recordings it was fitted to; *new*: "
        "motion it has not seen. Force and torque are mean differences of magnitude "
        "over all frames, angles are means over the frames in contact (force above "
        f"{threshold:g} N) where a direction exists.",
        "A person feels about 0.36 N or 7 % of a force, and 18 to 26° of its "
        "direction: errors below that cannot be felt.",
        *(f"## {each}\n\n![{each}]({name})" for name, each in pictures.items()),
    ]
    io.write_text(path, "\n\n".join(parts) + "\n")


def number(value: float, form: str = ".2f") -> str:
    """A number as text; a dash for NaN."""
    return "–" if math.isnan(value) else format(value, form)
