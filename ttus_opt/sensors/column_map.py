"""Which column of a file is which, from the command line or a small YAML file.

    t: stamp
    position: [x, y, z]
    quaternion: [q1, q2, q3, q4]
    quaternion_order: xyzw        # named, never guessed
    force: [Fx, Fy, Fz]
    torque: [Mx, My, Mz]

Single columns may be named as well (``px: x``), and for netCDF a variable that holds
all components (``position: tip``). A unit stands behind a name where the file states
none (``px: tip_x[mm]``, ``t: frame[1/60]``), and two columns are added up where they
make one (``t: sec+nanosec``, or as a list).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ttus_opt.core.errors import InputError, located
from ttus_opt.sensors.mapping_file import read_mapping

ORDERS = ("wxyz", "xyzw")
ORDER = "quaternion_order"

#: Vectors by the first letter of their components
VECTORS = {"position": "p", "force": "f", "torque": "t", "rotation_vector": "rv"}
QUATERNION = "quaternion"
SINGLE = (
    "t",
    *(f"{c}{x}" for c in ("p", "f", "t", "rv") for x in "xyz"),
    *(f"q{x}" for x in "wxyz"),
)
KNOWN = (*SINGLE, *VECTORS, QUATERNION, ORDER, "segment")


def read_column_map(source: str | os.PathLike[str]) -> dict[str, str]:
    """A file's column names, keyed by the package's names.

    Args:
        source: ``NAME=COLUMN,…``, or a YAML or JSON file.

    Raises:
        FileError: The file is missing or not a mapping.
        InputError: As `column_map`, or text that is not ``NAME=COLUMN``.
    """
    text = os.fspath(source)
    if Path(text).suffix.lower() in (".yaml", ".yml", ".json") and "=" not in text:
        with located(text):
            return column_map(read_mapping(text, "column map"))
    pairs = [pair.partition("=") for pair in text.split(",") if pair]
    if not all(ours and theirs for ours, _, theirs in pairs):
        raise InputError(f"--columns takes NAME=COLUMN,… or a YAML file, got {text!r}")
    return column_map({ours.strip(): theirs.strip() for ours, _, theirs in pairs})


def column_map(given: Mapping[str, Any]) -> dict[str, str]:
    """As `read_column_map`, from a mapping; lists are split into components.

    Raises:
        InputError: An unknown name, a value that is not text, a column named twice, or
            a quaternion without its order.
    """
    unknown = [name for name in given if name not in KNOWN]
    if unknown:
        raise InputError(
            f"columns has no {unknown[0]!r}: name t, position, quaternion, force, "
            "torque, rotation_vector, segment or a component such as px"
        )
    order = given.get(ORDER)
    if ORDER in given and order not in ORDERS:
        raise InputError(f"{ORDER} must be wxyz or xyzw, got {order!r}")
    out: dict[str, str] = {}
    for name, value in given.items():
        if isinstance(value, list):
            if name == "t" and len(value) == 2:
                out[name] = "+".join(_name(name, theirs) for theirs in value)
                continue
            if name not in (*VECTORS, QUATERNION):
                raise InputError(f"columns: {name} must be one column, got a list")
            for own, theirs in zip(_parts(name, value, order), value, strict=True):
                out[own] = _name(name, theirs)
        else:
            out[name] = _name(name, value)
    if QUATERNION not in out:
        out.pop(ORDER, None)  # its components are named one by one
    named = [value for name, value in out.items() if name != ORDER]
    twice = [value for value in named if named.count(value) > 1]
    if twice:
        raise InputError(
            f"columns names {twice[0]} twice: give each column one meaning"
        )
    return out


def table_columns(columns: Mapping[str, str]) -> Mapping[str, str]:
    """The map itself, checked for a table, which holds one number per column.

    Raises:
        InputError: One column is given for a whole vector.
    """
    whole = [n for n in columns if n in (*VECTORS, QUATERNION, ORDER)]
    if whole:
        raise InputError(
            f"a table has one number a column: list the columns of {whole[0]}, or name "
            "px, py, …"
        )
    return columns


def _parts(name: str, value: list[Any], order: Any) -> list[str]:
    """The package's names for a vector's components."""
    if name != QUATERNION:
        parts = [f"{VECTORS[name]}{x}" for x in "xyz"]
    elif order is None:
        raise InputError(
            f"columns lists a quaternion: add {ORDER}: wxyz or xyzw, the order is "
            "never guessed"
        )
    else:
        parts = [f"q{x}" for x in order]
    if len(value) != len(parts):
        raise InputError(f"columns: {name} has {len(parts)} components, got {value}")
    return parts


def _name(name: str, value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise InputError(f"columns: {name} must name a column, got {value!r}")
    return value
