"""Tables of errors, before and after fitting."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ttus_opt.report.document import Block, Heading, Table, Text
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


class Column(NamedTuple):
    """A figure of errors as tables have it.

    Attributes:
        title: Its name and unit.
        read: Reads it, in this unit.
        form: How it is written.
    """

    title: str
    read: Callable[[Errors], float]
    form: str = ".2f"

    def mean(self, errors: Sequence[Errors]) -> float:
        """Mean over recordings; NaN without any."""
        return float(np.mean([*map(self.read, errors)])) if errors else math.nan

    def cell(self, *errors: Errors) -> str:
        """The mean as a cell."""
        return number(self.mean(errors), self.form)


FORCE = Column("force [N]", lambda e: e.force_magnitude_error_N)
ANGLE = Column("angle [°]", lambda e: e.force_angle_error_deg, ".1f")

_COLUMNS = (
    FORCE,
    Column("rmse [N]", lambda e: e.force_magnitude_rmse_N),
    ANGLE,
    Column("torque [mN m]", lambda e: 1e3 * e.torque_magnitude_error_Nm, ".1f"),
    Column("angle [°]", lambda e: e.torque_angle_error_deg, ".1f"),
)


def error_table(comparisons: Sequence[Comparison]) -> Table:
    """Errors before → after and the frames in contact, one row per recording."""
    header = ["recording", "frames", *(column.title for column in _COLUMNS)]
    rows = []
    for case in comparisons:
        before, after = case.before.errors, case.after.errors
        kind = "same" if case.seen else "new"
        cells = [f"{case.recording} ({kind})"]
        cells.append(f"{after.frames_in_contact}/{after.frames}")
        cells += [f"{c.cell(before)} → {c.cell(after)}" for c in _COLUMNS]
        rows.append(cells)
    return Table(header, rows)


def error_section(comparisons: Sequence[Comparison]) -> list[Block]:
    """The table of errors before and after, with what it says."""
    threshold = comparisons[0].after.errors.force_threshold_N
    return [
        Heading("Errors before → after fitting"),
        error_table(comparisons),
        Text(
            "Before: the Laplace prior alone, its boundary scaled to the measured "
            "forces. After: the fitted field. *Same*: the recordings it was fitted to; "
            "*new*: motion it has not seen. Force and torque are mean differences of "
            "magnitude over all frames, angles are means over the frames in contact "
            f"(force above {threshold:g} N) where a direction exists."
        ),
        Text(
            "A person feels about 0.36 N or 7 % of a force, and 18 to 26° of its "
            "direction: errors below that cannot be felt."
        ),
    ]


def errors_by_name(named: Mapping[str, Errors]) -> Table:
    """Errors and the frames in contact, one row per name."""
    header = ["", "frames", *(column.title for column in _COLUMNS), "felt [%]"]
    rows = []
    for name, errors in named.items():
        cells = [name, f"{errors.frames_in_contact}/{errors.frames}"]
        cells += [column.cell(errors) for column in _COLUMNS]
        rows.append([*cells, number(100.0 * errors.share_told_apart, ".1f")])
    return Table(header, rows)


def number(value: float, form: str = ".2f") -> str:
    """A number as text; a dash for NaN."""
    return "–" if math.isnan(value) else format(value, form)
