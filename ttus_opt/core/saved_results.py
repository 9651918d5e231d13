"""Results in JSON files, so that interrupted work goes on where it was.

A result states what it was computed from, and is taken only where that is the same.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from ttus_opt.core import io


def plain(value: Any) -> Any:
    """Convert to dicts, lists and Python numbers; NaN and infinity become None.

    >>> import numpy as np
    >>> plain({"error": np.float64("nan"), "shape": (2, np.int64(3))})
    {'error': None, 'shape': [2, 3]}
    """
    if isinstance(value, Mapping):
        return {str(name): plain(each) for name, each in value.items()}
    if hasattr(value, "tolist"):  # NumPy, without importing it
        value = value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


Result = TypeVar("Result")


def computed_once(
    file: Path,
    inputs: Mapping[str, Any],
    compute: Callable[[], Result],
    *,
    save: Callable[[Result], Mapping[str, Any]],
    load: Callable[[dict[str, Any]], Result],
) -> Result:
    """A result from its file, or computed and written there.

    Args:
        file: The file, replaced only on success. A missing or damaged one, and one of
            other inputs, is not read.
        inputs: What the result is computed from, by name.
        compute: Computes it.
        save: Its content, for JSON.
        load: Inverse of ``save``; a `FileError` means that another file of the result
            is missing or damaged.

    Raises:
        FileError: The file cannot be written.
    """
    content = read_json(file)
    try:
        if all(content.get(name) == plain(value) for name, value in inputs.items()):
            return load(content)
    except (AttributeError, KeyError, TypeError, ValueError, OSError):
        pass  # JSON of another shape
    result = compute()
    write_json(file, {**inputs, **save(result)})
    return result


def restored(kind: type[Result], values: Mapping[str, Any]) -> Result:
    """A dataclass from its fields in JSON, in which null is NaN."""
    return kind(**{k: math.nan if v is None else v for k, v in values.items()})


def read_json(file: Path) -> Any:
    """Content of a JSON file; None where it is missing or damaged."""
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None


def write_json(file: Path, content: Mapping[str, Any], indent: int = 1) -> None:
    """Write JSON, replacing the file only on success; NaN and infinity become null."""
    text = json.dumps(
        plain(content), indent=indent, ensure_ascii=False, allow_nan=False
    )
    io.write_text(file, text + "\n")


def read_lines(file: Path) -> list[Any]:
    """Values of a file with one of JSON a line, without damaged lines."""
    values = []
    for line in file.read_text("utf-8").splitlines() if file.exists() else ():
        try:
            values.append(json.loads(line))
        except json.JSONDecodeError:
            continue  # truncated by an interruption
    return values


def append_line(file: Path, content: Any) -> None:
    """Add a value to such a file at once; its folder is created if missing."""
    io.made_folder(file.parent)
    with file.open("a", encoding="utf-8") as opened:
        opened.write(json.dumps(content) + "\n")
