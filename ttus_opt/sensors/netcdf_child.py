"""netCDF read by a process of its own: its C library crashes on damaged files.

`read_apart` starts this file as a script, which imports NumPy and netCDF4 alone and
hands the variables back. A crash, endless reading or a file that asks for too much
memory ends that process and not the one that asked.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Numbers of one variable at most, and per byte of the file: more than compression
#: holds are a damaged size, and would be filled in
MOST_NUMBERS, MOST_PER_BYTE = 100_000_000, 200

#: Labels of a coordinate at most; longer texts are nothing a stream needs
MOST_LABELS = 100

#: Longest reading [s]
PATIENCE = 300.0

#: Most memory of the process, and how much of it whatever the file, and per byte of it
#: [byte]: damaged counts are refused by their size, which else take the library minutes
MEMORY, MEMORY_AT_LEAST, MEMORY_PER_BYTE = 8 * 2**30, 2**30, 5_000

#: Nothing is computed there: threads would take address space
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


class Variable(NamedTuple):
    """A variable of a file.

    Attributes:
        dims: Names of its dimensions.
        values: Numbers, or labels as texts.
        attributes: Those that are texts.
    """

    dims: tuple[str, ...]
    values: NDArray[Any]
    attributes: dict[str, str]


def read_apart(file: Path) -> dict[str, Variable]:
    """All variables of a netCDF file.

    Args:
        file: That is there.

    Raises:
        ValueError: It cannot be read; why is not always known.
    """
    command = [sys.executable, "-P", __file__, str(file)]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            timeout=PATIENCE,
            check=False,
            env={**os.environ, **ONE_THREAD},
        )
    except subprocess.TimeoutExpired as error:
        raise ValueError("reading takes for ever") from error
    if done.returncode:
        raise ValueError(f"its reader ended with status {done.returncode}")
    return unpacked(done.stdout)


def packed(file: str) -> bytes:
    """What the process hands back: numbers as NPZ, all else as JSON in it."""
    import netCDF4

    arrays: dict[str, NDArray[Any]] = {}
    most = min(MOST_NUMBERS, MOST_PER_BYTE * Path(file).stat().st_size)
    told: list[dict[str, Any]] = []
    with netCDF4.Dataset(file) as opened:
        for number, (name, variable) in enumerate(opened.variables.items()):
            if variable.size > most:
                raise ValueError(f"{name} is too long")
            values = np.ma.asarray(variable[...])
            labels = None
            if values.dtype.kind in "fiu":
                arrays[f"v{number}"] = np.ma.filled(values.astype(np.float64), np.nan)
            elif values.size <= MOST_LABELS:
                labels = [str(label) for label in values.reshape(-1)]
            attributes = {
                key: str(value)
                for key, value in variable.__dict__.items()
                if isinstance(value, str)
            }
            told.append(
                {
                    "name": name,
                    "dims": list(variable.dimensions),
                    "shape": list(variable.shape),
                    "labels": labels,
                    "attributes": attributes,
                }
            )
    content = io.BytesIO()
    arrays["told"] = np.array(json.dumps(told))
    np.savez(content, **arrays)  # type: ignore[arg-type]  # names are none of its own
    return content.getvalue()


def unpacked(content: bytes) -> dict[str, Variable]:
    """The variables of `packed`."""
    out = {}
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        for number, each in enumerate(json.loads(str(arrays["told"]))):
            if f"v{number}" in arrays:
                values = arrays[f"v{number}"]
            elif each["labels"] is not None:
                values = np.array(each["labels"], dtype=str).reshape(each["shape"])
            else:
                continue
            dims = tuple(each["dims"])
            out[each["name"]] = Variable(dims, values, each["attributes"])
    return out


def limit_memory(file: str) -> None:
    """So that a damaged size does not take the machine's."""
    try:
        import resource
    except ImportError:  # not on Windows
        return
    most = MEMORY_AT_LEAST + MEMORY_PER_BYTE * Path(file).stat().st_size
    resource.setrlimit(resource.RLIMIT_AS, (min(most, MEMORY), MEMORY))


if __name__ == "__main__":
    limit_memory(sys.argv[1])
    sys.stdout.buffer.write(packed(sys.argv[1]))
