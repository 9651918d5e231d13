"""The trajectory table: poses over time, with wrenches or without."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.core import io
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import FileError
from ttus_opt.probe.column_names import ROTATION_VECTOR
from ttus_opt.probe.raw_recording import COMPONENTS, RawRecording
from ttus_opt.probe.text_table import TextTable, read_text_table, seconds

TIME, POSITION, QUATERNION, FORCE, TORQUE = COMPONENTS.values()
SEGMENT = "segment"


def raw_trajectory(
    path: str | os.PathLike[str], columns: Mapping[str, str] | None = None
) -> RawRecording:
    """The columns of a trajectory file, as it has them, with its holes.

    Args:
        path: The CSV file.
        columns: The file's own names of columns, by the package's.

    Raises:
        FileError: Not a table of poses.
    """
    file = io.existing_file(path, "trajectory")
    required = (*TIME, *POSITION, *QUATERNION)
    table = read_text_table(file, required, columns)
    turned = all(name in table.names for name in ROTATION_VECTOR)
    turns = QUATERNION if "qw" in table.names or not turned else ROTATION_VECTOR
    return recording_of(table, "trajectory", (*POSITION, *turns))


def recording_of(table: TextTable, what: str, required: Sequence[str]) -> RawRecording:
    """The columns of a table as a recording.

    Args:
        table: The table.
        what: What it is, for errors.
        required: Names beside the time that it has.

    Raises:
        FileError: A column comes twice, or half a wrench.
    """
    source = f"{what} {table.file}".strip()
    known = (*TIME, *required, *FORCE, *TORQUE, SEGMENT)
    wanted = [name for name in table.names if name in known]
    twice = sorted({name for name in wanted if wanted.count(name) > 1})
    if twice:
        raise FileError(
            f"{source} has column {', '.join(twice)} more than once: remove one"
        )
    _refuse_half_a_wrench(source, wanted)
    values, unread = table.readable(wanted)

    def part(names: Sequence[str]) -> Array | None:
        if names[0] not in wanted:
            return None
        return values[:, [wanted.index(name) for name in names]]

    time = part(TIME)
    assert time is not None
    quaternion = part(QUATERNION)
    vectors = part(ROTATION_VECTOR)
    if quaternion is None and vectors is not None:
        quaternion = Rotation.from_rotvec(vectors).as_quat(scalar_first=True)
    unstated, units = _units(table.header.stated, wanted)
    return RawRecording(
        source,
        seconds(time[:, 0]),
        part(POSITION),
        quaternion,
        part(FORCE),
        part(TORQUE),
        _segments(table, source, part([SEGMENT])),
        table.line,
        unread,
        notes=(f"{units}, {table.header.frame}",),
        cautions=table.header.notes,
        units_stated=not unstated,
    )


def _units(stated: Mapping[str, str], names: Sequence[str]) -> tuple[list[str], str]:
    """The columns without a unit, and a note of all units."""
    of_unit: dict[str, list[str]] = {}
    for name in names:
        if name != SEGMENT and name not in QUATERNION:
            of_unit.setdefault(stated.get(name, ""), []).append(name)
    unstated = of_unit.pop("", [])
    if not of_unit:
        return unstated, "SI, as none are stated"
    if unstated:
        of_unit["SI units"] = unstated
    told = [f"{' '.join(own)} in {unit}" for unit, own in of_unit.items()]
    return unstated, ", ".join(told)


def _refuse_half_a_wrench(source: str, names: Sequence[str]) -> None:
    """Forces are three columns or none, and so are torques beside them."""
    for own in (FORCE, TORQUE):
        missing = [name for name in own if name not in names]
        if 0 < len(missing) < 3:
            raise FileError(
                f"{source} has no column {', '.join(missing)}: it needs "
                f"{','.join(own)}, all or none"
            )
    if TORQUE[0] in names and FORCE[0] not in names:
        raise FileError(
            f"{source} has no column {', '.join(FORCE)}: torques need forces too"
        )


def _segments(table: TextTable, source: str, column: Array | None) -> IntArray:
    if column is None:
        return np.zeros(len(table.cells), dtype=np.int64)
    values = column[:, 0]
    with np.errstate(invalid="ignore"):
        whole = (np.abs(values) < 2**53) & (values == np.round(values))
    if not whole.all():
        row = int(np.argmin(whole))
        raise FileError(
            f"{source}, line {table.line[row]}: segment must be a whole number, got "
            f"{values[row]:.6g}"
        )
    return np.asarray(values.astype(np.int64))
