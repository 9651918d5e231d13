"""netCDF files in memory, by a process of its own where one may be damaged.

The netCDF library crashes on some damaged files. `contents_apart` runs this file as a
script, which imports only NumPy and netCDF4 and returns what it read: a crash, an
endless loop or a request for too much memory ends that process, not the caller.
"""

from __future__ import annotations

import io
import json
import math
import os
import subprocess
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Most numbers of one variable, and per byte of the file: a size beyond what
#: compression achieves is damaged, and netCDF would fill it with a constant
MOST_NUMBERS, MOST_PER_BYTE = 100_000_000, 200

#: Time limit [s]
PATIENCE = 300.0

#: Memory limit of the process: largest, fixed part, and part per byte of the file
#: [byte]; a damaged size fails at once instead of keeping the library busy for minutes
MEMORY, MEMORY_AT_LEAST, MEMORY_PER_BYTE = 8 * 2**30, 2**30, 5_000

#: It computes nothing: threads would only take address space
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

#: Attributes that say which number stands for a missing one
FILLINGS = {"_FillValue", "missing_value"}


class Variable(NamedTuple):
    """A variable of a netCDF file.

    Attributes:
        dims: Names of its dimensions.
        values: NaN where they are missing.
        attrs: Its attributes.
    """

    dims: tuple[str, ...]
    values: NDArray[Any]
    attrs: Mapping[str, Any]


class Content(NamedTuple):
    """Variables of a netCDF file, by name, and its attributes."""

    variables: Mapping[str, Variable]
    attrs: Mapping[str, Any]


def contents(
    file: Path, without: Sequence[str] = (), most: float = math.inf
) -> Content:
    """A file in memory, without xarray, which loads slowly.

    Args:
        file: The file.
        without: Variables to skip; ``*`` stands for all.
        most: Most numbers of one variable.

    Raises:
        ValueError: A variable is longer; the library raises nearly every class.
    """
    import netCDF4

    variables = {}
    with warnings.catch_warnings(), netCDF4.Dataset(file) as opened:
        # numpy 2.4 warns inside netCDF4's compiled reader about array shapes
        warnings.simplefilter("ignore", DeprecationWarning)
        for name, one in opened.variables.items():
            if name in without or "*" in without:
                continue
            if one.size > most:
                raise ValueError(f"{name} is too long")
            attrs = dict(one.__dict__)
            # else a whole number that is the type's usual filling would be missing
            one.set_auto_mask(one.dtype in ("f4", "f8") or bool(FILLINGS & set(attrs)))
            values = one[...]
            if np.ma.is_masked(values):
                values = values.astype(np.float64).filled(np.nan)
            values = np.ma.getdata(values)
            if values.dtype.kind == "O":  # text
                values = values.astype(str)
            variables[name] = Variable(one.dimensions, values, attrs)
        return Content(variables, dict(opened.__dict__))


def contents_apart(file: Path) -> Content:
    """All of a file, read by a process of its own.

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
    """What the process returns: arrays in NPZ, their names in a list of JSON."""
    size = Path(file).stat().st_size
    found = contents(Path(file), most=min(MOST_NUMBERS, MOST_PER_BYTE * size))
    arrays: dict[str, Any] = {}
    names: list[tuple[str, tuple[str, ...], list[str]]] = []
    for name, (dims, values, attrs) in [
        ("", Variable((), np.zeros(0), found.attrs)),
        *found.variables.items(),
    ]:
        arrays[f"v{len(names)}"] = values
        arrays |= {f"a{len(names)}.{i}": v for i, v in enumerate(attrs.values())}
        names.append((name, dims, list(attrs)))
    content = io.BytesIO()
    np.savez(content, names=np.array(json.dumps(names)), **arrays)
    return content.getvalue()


def unpacked(content: bytes) -> Content:
    """Inverse of `packed`."""
    variables = {}
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        for k, (name, dims, keys) in enumerate(json.loads(str(arrays["names"]))):
            each = (arrays[f"a{k}.{i}"][()] for i in range(len(keys)))
            values = (str(v) if isinstance(v, str) else v for v in each)
            attrs = dict(zip(keys, values, strict=True))
            variables[name] = Variable(tuple(dims), arrays[f"v{k}"], attrs)
    return Content(variables, variables.pop("").attrs)


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
