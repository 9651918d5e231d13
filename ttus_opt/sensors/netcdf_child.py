"""netCDF read in a child process, because its C library crashes on damaged files.

`read_apart` runs this file as a script, which imports only NumPy and netCDF4 and
returns the variables. A crash, an endless loop or a request for too much memory ends
the child process, not the caller.
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

#: Most numbers of one variable, and per byte of the file: a size beyond what
#: compression achieves is damaged, and netCDF would fill it with a constant
MOST_NUMBERS, MOST_PER_BYTE = 100_000_000, 200

#: Most labels of a coordinate; a stream needs few
MOST_LABELS = 100

#: Time limit [s]
PATIENCE = 300.0

#: Memory limit of the child: largest, fixed part, and part per byte of the file [byte];
#: a damaged size fails at once instead of keeping the library busy for minutes
MEMORY, MEMORY_AT_LEAST, MEMORY_PER_BYTE = 8 * 2**30, 2**30, 5_000

#: The child computes nothing: threads would only take address space
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


class Variable(NamedTuple):
    """A variable of a file.

    Attributes:
        dims: Names of its dimensions.
        values: Numbers, or labels as text.
        attributes: Only those that are text.
    """

    dims: tuple[str, ...]
    values: NDArray[Any]
    attributes: dict[str, str]


def read_apart(file: Path) -> dict[str, Variable]:
    """All variables of an existing netCDF file.

    Raises:
        ValueError: It cannot be read; the cause is not always known.
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
        raise ValueError("reading takes too long") from error
    if done.returncode:
        raise ValueError(f"its reader ended with status {done.returncode}")
    return unpacked(done.stdout)


def packed(file: str) -> bytes:
    """Output of the child process: numbers as NPZ, all else as JSON in it."""
    import netCDF4

    arrays: dict[str, NDArray[Any]] = {}
    most = min(MOST_NUMBERS, MOST_PER_BYTE * Path(file).stat().st_size)
    facts: list[dict[str, Any]] = []
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
            facts.append(
                {
                    "name": name,
                    "dims": list(variable.dimensions),
                    "shape": list(variable.shape),
                    "labels": labels,
                    "attributes": attributes,
                }
            )
    content = io.BytesIO()
    arrays["facts"] = np.array(json.dumps(facts))
    np.savez(content, **arrays)  # type: ignore[arg-type]  # names are none of its own
    return content.getvalue()


def unpacked(content: bytes) -> dict[str, Variable]:
    """The variables of `packed`."""
    out = {}
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        for number, each in enumerate(json.loads(str(arrays["facts"]))):
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
    """Limit this process's memory, because a damaged size may ask for all of it."""
    try:
        import resource
    except ImportError:  # not on Windows
        return
    most = MEMORY_AT_LEAST + MEMORY_PER_BYTE * Path(file).stat().st_size
    resource.setrlimit(resource.RLIMIT_AS, (min(most, MEMORY), MEMORY))


if __name__ == "__main__":
    limit_memory(sys.argv[1])
    sys.stdout.buffer.write(packed(sys.argv[1]))
