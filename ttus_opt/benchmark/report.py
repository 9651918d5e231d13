"""The benchmark's report, and its tables as CSV."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ttus_opt.benchmark.parts.base import parts
from ttus_opt.benchmark.row import Row, Settings
from ttus_opt.core import io
from ttus_opt.report import document
from ttus_opt.report.document import Block, Heading, Items, Text


def write_report(
    folder: Path,
    found: Mapping[str, Sequence[Row]],
    settings: Settings,
    *,
    command: str,
    machine: Mapping[str, str],
) -> Path:
    """Write the report with its pictures, and a CSV file per part.

    Args:
        folder: Folder of the results.
        found: Finished rows by part; a part without rows is left out.
        settings: Settings of the benchmark.
        command: The command line.
        machine: Description from `ttus_opt.benchmark.machine.describe`.

    Returns:
        The report's path.

    Raises:
        FileError: The folder cannot be written to.
    """
    blocks: list[Block] = [Heading("Benchmark", 1), Text(f"`{command}`")]
    for name, rows in found.items():
        if rows:
            blocks += parts()[name].report(rows, settings)
            write_csv(folder / f"{name}.csv", rows)
    facts = [f"{name}: {it}" for name, it in machine.items()]
    return document.write_report(folder, [*blocks, Heading("Machine"), Items(facts)])


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as CSV, nested values as ``kkt.primal``.

    Raises:
        FileError: The folder cannot be written to.
    """
    flat = [_flat(row) for row in rows]
    header = list(dict.fromkeys(key for row in flat for key in row))
    with io.replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, header)
        writer.writeheader()
        writer.writerows(flat)


def _flat(row: Mapping[str, Any], prefix: str = "") -> Row:
    """The row with nested mappings flattened."""
    flat: Row = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat
