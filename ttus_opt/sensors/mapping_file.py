"""Small YAML or JSON files that hold a mapping."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

from ttus_opt import io
from ttus_opt.errors import FileError, MissingPackageError
from ttus_opt.optional import load

#: Largest file [byte]
LARGEST_FILE = 100_000


def read_mapping(path: str | os.PathLike[str], what: str) -> Mapping[str, Any]:
    """The mapping of a YAML or JSON file, plain values only.

    Args:
        path: The file; YAML needs the extra ``sensors``.
        what: What it should be, for the message ("session").

    Raises:
        FileError: Missing, too large, neither YAML nor JSON, or no mapping.
        MissingPackageError: PyYAML is not installed.
    """
    file = io.existing_file(path, what)
    if file.stat().st_size > LARGEST_FILE:
        raise FileError(f"{file} is too large for a {what}: wrong file?")
    try:
        text = file.read_text(encoding="utf-8-sig")
        found = json.loads(text) if file.suffix.lower() == ".json" else _yaml(text)
    except MissingPackageError:
        raise
    except Exception as error:  # the parsers raise nearly every class
        raise FileError(
            f"{file} does not read as YAML or JSON{_place(error)}: a {what} is a "
            "mapping of names to values"
        ) from error
    if not isinstance(found, Mapping) or not all(isinstance(k, str) for k in found):
        raise FileError(f"{file} is no {what}: it must map names to values")
    return found


def _yaml(text: str) -> Any:
    yaml: Any = load("yaml", "sensors")
    return yaml.safe_load(text)


def _place(error: Exception) -> str:
    """Where a parser stopped, where it says so."""
    mark = getattr(error, "problem_mark", None)
    line = getattr(error, "lineno", None) if mark is None else mark.line + 1
    return "" if line is None else f" (line {line})"
