"""Logs of ATI's Net F/T: a preamble, status, sequence numbers, counts per newton.

    Start Time: 3/12/26 10:01 AM
    RDT Sample Rate: 1000
    Force Units: N
    Counts per Unit Force: 1000000.0
    Torque Units: Nm
    Counts per Unit Torque: 1000000.0
    Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time

Times are the RDT sequence numbers at the sample rate, so that a lost packet is a gap;
the column ``Time`` has whole seconds only. Readings that are whole numbers are counts.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ttus_opt.core.errors import FileError
from ttus_opt.probe.column_names import UNITS, factor
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.probe.text_table import read_text_table
from ttus_opt.sensors.stream_format import StreamFormat, Wanted

SEQUENCE, STATUS = "RDT Sequence", "Status (hex)"
FORCE, TORQUE = ("fx", "fy", "fz"), ("tx", "ty", "tz")


def _read(file: Path, wanted: Wanted) -> list[RawRecording]:
    """The log's wrenches."""
    table = read_text_table(file, (SEQUENCE, *FORCE, *TORQUE))
    preamble = "\n".join(table.preamble)
    rate = _number(file, preamble, "RDT Sample Rate")
    numbers, unread = table.readable([SEQUENCE, *FORCE, *TORQUE])
    sequence, readings = numbers[:, 0], numbers[:, 1:]
    known = readings[np.isfinite(readings).all(axis=1)]
    counts = bool(len(known)) and bool((known == np.round(known)).all())
    words, notes = [], []
    for quantity, columns in (("Force", slice(0, 3)), ("Torque", slice(3, 6))):
        unit = _unit(file, preamble, quantity)
        scale = factor(quantity.lower(), unit)
        if scale is None:
            raise FileError(
                f"{file}: unknown {quantity.lower()} unit {unit!r}, expected one of "
                f"{', '.join(UNITS[quantity.lower()])}"
            )
        per_unit = _number(file, preamble, f"Counts per Unit {quantity}")
        readings[:, columns] *= scale / (per_unit if counts else 1.0)
        words.append(unit)
        notes.append(f"{per_unit:g} per {unit}")
    told = f"counts, {' and '.join(notes)}" if counts else " and ".join(words)
    known = sequence[np.isfinite(sequence)]
    first, lost = known[:1], int((np.diff(known) - 1).clip(0).sum())
    packets = f", lost packets: {lost:,}" if lost else ""
    raw = RawRecording(
        str(file),
        (sequence - (first[0] if len(first) else 0.0)) / rate,
        force=readings[:, :3],
        torque=readings[:, 3:],
        line=table.line,
        unread=unread,
        notes=(
            f"{told}, the sensor's axes",
            f"times are sequence numbers at {rate:g} Hz{packets}",
        ),
        units_stated=True,
    )
    return [raw.without(_failed(table.cells, table.names), "with an error status")]


def _failed(cells: list[list[str]], names: list[str]) -> np.ndarray:
    """Mask of the readings whose status has the sensor's error bit (31), shape (T,)."""
    if STATUS not in names:
        return np.zeros(len(cells), bool)
    at = names.index(STATUS)
    words = [row[at].lower().removeprefix("0x") for row in cells]
    return np.array([_hexadecimal(word) >> 31 & 1 for word in words], bool)


def _hexadecimal(word: str) -> int:
    return int(word, 16) if re.fullmatch(r"[0-9a-f]{1,16}", word) else 0


def _number(file: Path, preamble: str, name: str) -> float:
    found = re.search(rf"{name}: *\"?([0-9.eE+]+)", preamble)
    try:
        value = float(found[1]) if found else 0.0
    except ValueError:
        value = 0.0
    if not 0.0 < value < np.inf:
        raise FileError(f"{file} does not state the {name}: log it again")
    return value


def _unit(file: Path, preamble: str, quantity: str) -> str:
    found = re.search(rf"^\"?{quantity} Units: *([^\",;\n]+)", preamble, re.MULTILINE)
    if found is None:
        raise FileError(f"{file} does not state the {quantity} Units: log it again")
    return found[1].strip()


ATI = StreamFormat(
    "log of ATI's Net F/T",
    lambda file, head: "Counts per Unit Force" in head and SEQUENCE in head,
    _read,
)
