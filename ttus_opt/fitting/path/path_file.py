"""The file of a path: what it holds already, and what is added as points are done."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ttus_opt.core import io
from ttus_opt.core.errors import FileError, warn
from ttus_opt.fitting.path.path_dataset import (
    INPUTS,
    PathRecord,
    read_solution_path,
    write_solution_path,
)

if TYPE_CHECKING:
    import xarray as xr

#: Least time between two writes before the path is complete [s]
SAVE_EVERY = 30.0


class PathFile:
    """Keeps the points of a path in a file, so that another call goes on from them.

    Args:
        file: The file, which need not exist.
        record: The points, of which those in the file are taken at once.
        inputs: Checksums of the path's inputs.

    Raises:
        FileError: The file cannot be written.
    """

    def __init__(
        self,
        file: str | os.PathLike[str],
        record: PathRecord,
        inputs: Mapping[str, str],
    ) -> None:
        io.check_output(file)
        self._file, self._record = file, record
        kept = _kept(file, inputs)
        if kept is not None:
            record.take(kept)
        self._saved_points, self._saved_at = record.done, time.monotonic()

    def __str__(self) -> str:
        return str(self._file)

    def save_now_and_then(self) -> None:
        """Write the points, unless that was done a moment ago."""
        if time.monotonic() - self._saved_at > SAVE_EVERY:
            self.save()

    def save(self) -> None:
        """Write the points, if there are new ones."""
        if self._record.done > self._saved_points:
            write_solution_path(self._record.dataset(), self._file)
            self._saved_points = self._record.done
        self._saved_at = time.monotonic()


def _kept(file: str | os.PathLike[str], inputs: Mapping[str, str]) -> xr.Dataset | None:
    """The path in a file; None, with a warning, where it cannot be continued."""
    if not Path(file).exists():
        return None
    try:
        saved = read_solution_path(file)
        stated = json.loads(saved.attrs.get(INPUTS, "{}"))
    except (FileError, ValueError) as error:
        warn(f"all points are computed, and the file is replaced: {error}", 3)
        return None
    other = [name for name in inputs if stated.get(name) != inputs[name]]
    if "scene" in other and "formulation" in other:
        other.remove("formulation")  # its rows are those of the scene
    if not other:
        return saved
    what = f"other inputs ({', '.join(other)})" if stated else "unknown inputs"
    warn(
        f"{file} holds a path of {what}: all points are computed, and the file is "
        "replaced",
        3,
    )
    return None
