"""Checksums of a dataset's content, and of all bytes of its file.

A flipped bit in a file changes a value silently; netCDF has no checksum unless every
variable is stored in chunks. Here every variable with its attributes has one, stored
as one attribute, so that a reader that leaves a large variable out can still check the
others. A flipped bit may also let the netCDF library run on and on, so the file ends in
a checksum of all bytes before, which is compared before the library reads them. HDF5
permits bytes after its own.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.core.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

#: The attribute: a JSON object of checksums by variable; "" stands for the attributes
ATTRIBUTE = "ttus_opt_checksums"

#: What a file ends in: this, and the CRC-32 of all bytes before as 8 hex digits
SEAL = b"\nttus_opt crc32 "

#: Digits of a CRC-32, and bytes that are read at a time
DIGITS, AT_A_TIME = 8, 2**20


def seal(file: Path) -> None:
    """Append the checksum of all bytes."""
    digits = _crc(file, file.stat().st_size)
    with file.open("ab") as opened:
        opened.write(SEAL + digits)


def check_seal(file: Path) -> None:
    """Compare a file with the checksum it ends in; a file without one passes.

    Raises:
        InputError: A byte is not what was written.
    """
    size = file.stat().st_size - len(SEAL) - DIGITS
    with file.open("rb") as opened:
        opened.seek(max(0, size))
        mark, digits = opened.read(len(SEAL)), opened.read()
    if size >= 0 and mark == SEAL and digits != _crc(file, size):
        raise InputError(
            "its bytes are not what was written: the file is damaged, or another "
            "program changed it: copy or write it again"
        )


def _crc(file: Path, size: int) -> bytes:
    """CRC-32 of the first bytes, as hex digits."""
    crc = 0
    with file.open("rb") as opened:
        while part := opened.read(min(AT_A_TIME, size)):
            crc, size = zlib.crc32(part, crc), size - len(part)
    return b"%08x" % crc


def with_checksums(dataset: xr.Dataset) -> xr.Dataset:
    """The dataset with the checksums of its content among its attributes."""
    return dataset.assign_attrs({ATTRIBUTE: json.dumps(_checksums(dataset))})


def has_checksums(dataset: xr.Dataset) -> bool:
    """Whether checksums are stored with the content."""
    return ATTRIBUTE in dataset.attrs


def check_content(dataset: xr.Dataset, left_out: Collection[str] = ()) -> None:
    """Compare the content with its checksums.

    Args:
        dataset: As read, with `ATTRIBUTE`.
        left_out: Variables that were not read.

    Raises:
        InputError: A variable, or an attribute, is not what was written.
    """
    try:
        stated = json.loads(dataset.attrs[ATTRIBUTE])
    except (TypeError, ValueError):
        stated = None
    if not isinstance(stated, dict):
        raise InputError("its checksums are damaged: copy or write the file again")
    computed = _checksums(dataset)
    for name in sorted({*stated, *computed} - {*left_out}):
        if stated.get(name) != computed.get(name):
            raise InputError(
                f"{name or 'an attribute'} is not what was written: the file is "
                f"damaged, or another program changed it: copy or write it again"
            )


def _checksums(dataset: xr.Dataset) -> dict[str, str]:
    of = {str(name): _of_variable(one) for name, one in dataset.variables.items()}
    return {"": _digest(_text(dataset.attrs)), **of}


def _of_variable(variable: xr.Variable) -> str:
    import numpy as np

    values = np.asarray(variable.values)
    facts = [*map(str, variable.dims), *map(str, values.shape)]
    if values.dtype.kind in "OSU":
        content = json.dumps([str(value) for value in values.ravel()]).encode()
    else:
        facts.append(values.dtype.newbyteorder("<").str)
        content = values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes()
    return _digest(json.dumps(facts).encode(), _text(variable.attrs), content)


def _text(attributes: Mapping[Any, Any]) -> bytes:
    """Attributes in one form, before writing and after reading."""
    import numpy as np

    plain = {
        str(name): value if isinstance(value, str) else np.asarray(value).tolist()
        for name, value in attributes.items()
        if name != ATTRIBUTE
    }
    return json.dumps(plain, sort_keys=True, default=str).encode()


def _digest(*parts: bytes) -> str:
    digest = hashlib.blake2b(digest_size=8)
    for part in parts:
        digest.update(part)
    return digest.hexdigest()
