"""A recording as its file has it: SI units, the package's names, nothing checked yet.

Every reader of poses or wrenches returns these. What is wrong with one is listed by
`ttus_opt.probe.recording_faults`, and repaired by `ttus_opt.probe.repair`.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arrays import Array, IntArray, Mask

#: Names of the components of each array
COMPONENTS: dict[str, tuple[str, ...]] = {
    "time": ("t",),
    "position": ("px", "py", "pz"),
    "quaternion": ("qw", "qx", "qy", "qz"),
    "force": ("fx", "fy", "fz"),
    "torque": ("tx", "ty", "tz"),
}


@dataclass(frozen=True)
class RawRecording:
    """Readings at T times, NaN where one is missing.

    Attributes:
        source: What it was read from, as an error names it.
        time: Shape (T,) [s].
        position: Shape (T, 3) [m]; None where the stream has no poses.
        quaternion: w, x, y, z, shape (T, 4) [–]; None where it has no rotations.
        force: Shape (T, 3) [N]; None where it has none.
        torque: Shape (T, 3) [N·m]; None where it has none.
        segment: Number of the recording, shape (T,) [–]; one by default.
        line: Line of the file of each row, shape (T,); empty where it has no lines.
        unread: Why a cell is not a number, by row.
        name: Name of the stream in its file; empty where there is one only.
        notes: Units and frame, as the format or the file states them, then gaps.
        cautions: What was taken for granted or changed; a reader warns of it.
        units_stated: Whether the format or the file states the units.
    """

    source: str
    time: Array
    position: Array | None = field(default=None, repr=False)
    quaternion: Array | None = field(default=None, repr=False)
    force: Array | None = field(default=None, repr=False)
    torque: Array | None = field(default=None, repr=False)
    segment: IntArray = field(
        default_factory=lambda: np.zeros(0, dtype=np.int64), repr=False
    )
    line: IntArray = field(
        default_factory=lambda: np.zeros(0, dtype=np.int64), repr=False
    )
    unread: Mapping[int, str] = field(default_factory=dict, repr=False)
    name: str = ""
    notes: tuple[str, ...] = ()
    cautions: tuple[str, ...] = ()
    units_stated: bool = False

    def __post_init__(self) -> None:
        """Give every row a segment."""
        if len(self.segment) == 0:
            object.__setattr__(self, "segment", np.zeros(len(self.time), np.int64))

    def __len__(self) -> int:
        """Number of rows T [–]."""
        return len(self.time)

    @property
    def has_poses(self) -> bool:
        """Whether there are positions and rotations."""
        return self.position is not None and self.quaternion is not None

    @property
    def has_wrenches(self) -> bool:
        """Whether there are forces."""
        return self.force is not None

    @property
    def title(self) -> str:
        """Source and name, as an error begins."""
        return f"{self.source}, {self.name}" if self.name else self.source

    @property
    def steps(self) -> Array:
        """Time since the row before, NaN where a segment begins, shape (T,) [s]."""
        return steps_within(self.time, self.segment)

    def place(self, row: int) -> str:
        """Where a row is, as a person finds it."""
        return f"line {self.line[row]}" if len(self.line) else f"frame {row}"

    def arrays(self) -> dict[str, Array]:
        """Numbers by name, time first; without what the stream does not have."""
        found = {name: getattr(self, name) for name in COMPONENTS}
        return {name: values for name, values in found.items() if values is not None}

    def rows(self) -> Array:
        """All numbers as one table, shape (T, k)."""
        shape = {name: (len(self), len(of)) for name, of in COMPONENTS.items()}
        return np.hstack([v.reshape(shape[k]) for k, v in self.arrays().items()])

    def save(self, path: str | os.PathLike[str], *, digits: int = 17) -> None:
        """Write the table that a reader of tables reads, whole or not at all.

        Raises:
            FileError: The file cannot be written.
        """
        names = [name for part in self.arrays() for name in COMPONENTS[part]]
        # 17 digits restore every double, but repr's are fewer where they suffice
        written = repr if digits >= 17 else f"{{:.{digits}g}}".format
        lines = [",".join(map(written, row)) for row in self.rows().tolist()]
        if len(parts(self.segment)) > 1:
            names.append("segment")
            lines = [f"{a},{s}" for a, s in zip(lines, self.segment, strict=True)]
        io.write_text(path, "\n".join([",".join(names), *lines, ""]))

    def select(self, rows: Mask | IntArray) -> RawRecording:
        """Some of the rows, in the order given."""
        at = np.arange(len(self))[rows]
        unread = {}
        if self.unread:
            places = enumerate(at.tolist())
            unread = {i: self.unread[row] for i, row in places if row in self.unread}
        line = self.line[at] if len(self.line) else self.line
        kept = {name: values[at] for name, values in self.arrays().items()}
        return self.replaced(**kept, segment=self.segment[at], line=line, unread=unread)

    def replaced(self, **changes: Any) -> RawRecording:
        """The same with some attributes changed."""
        return replace(self, **changes)

    def without(self, lost: Mask, what: str) -> RawRecording:
        """The rows that a device did not declare lost, a new segment after each loss.

        Args:
            lost: Shape (T,).
            what: What the device says of them, for the notes.
        """
        if not lost.any():
            return self
        part = np.cumsum(lost) + (int(lost.sum()) + 1) * self.segment
        kept = self.replaced(segment=part.astype(np.int64)).select(~lost)
        number = np.unique(kept.segment, return_inverse=True)[1].reshape(-1)
        return kept.replaced(segment=number.astype(np.int64)).noted(
            f"{int(lost.sum()):,} of {len(lost):,} frames are {what}: gaps"
        )

    def noted(self, *notes: str) -> RawRecording:
        """The same with more notes."""
        return replace(self, notes=(*self.notes, *notes))


def steps_within(time: Array, segment: IntArray) -> Array:
    """Time since the frame before, NaN where a segment begins, shape (T,) [s]."""
    steps = np.diff(time, prepend=np.nan)
    steps[1:][np.diff(segment) != 0] = np.nan
    return steps


def complete(values: Array) -> Mask:
    """Mask of the rows (T, k) that are finite throughout, shape (T,)."""
    return np.asarray(np.isfinite(values).all(axis=1), dtype=bool)


def parts(segment: NDArray[np.int64]) -> list[slice]:
    """The runs of equal numbers, in order."""
    cuts = np.flatnonzero(np.diff(segment)) + 1
    edges = [0, *cuts.tolist(), len(segment)]
    return [slice(a, b) for a, b in itertools.pairwise(edges) if b > a]
