"""Cells of CSV files whose header has several lines."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError


def read_cells(file: Path) -> list[list[str]]:
    """The cells of every line, without blanks around them.

    Raises:
        FileError: Not a text file of cells.
    """
    try:
        with file.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
            return [[cell.strip() for cell in row] for row in csv.reader(stream)]
    except csv.Error as error:
        raise FileError(f"{file} is no CSV file ({error}): export it again") from error


def number(cell: str) -> float:
    """A cell as a number, NaN where it is none."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def numbers(rows: Sequence[Sequence[str]], width: int) -> Array:
    """The first cells of rows as numbers, shape (T, width); NaN for what is none."""
    out = np.full((len(rows), width), np.nan)
    for i, row in enumerate(rows):
        for j, cell in enumerate(row[:width]):
            if cell:
                out[i, j] = number(cell)
    return out
