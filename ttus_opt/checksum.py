"""Checksums of a dataset's content, stored with it as one attribute.

A flipped bit in a file changes a value silently; netCDF has no checksum unless every
variable is stored in chunks. Here every variable with its attributes has one, so that
a reader that leaves a large variable out can still check the others.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

#: The attribute: a JSON object of checksums by variable; "" stands for the attributes
ATTRIBUTE = "ttus_opt_checksums"


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
    found = _checksums(dataset)
    for name in sorted({*stated, *found} - {*left_out}):
        if stated.get(name) != found.get(name):
            raise InputError(
                f"{name or 'an attribute'} is not what was written: the file is "
                f"damaged, or another program changed it: copy or write it again"
            )


def _checksums(dataset: xr.Dataset) -> dict[str, str]:
    of = {str(name): _of_variable(one) for name, one in dataset.variables.items()}
    return {"": _digest(_text(dataset.attrs)), **of}


def _of_variable(variable: xr.Variable) -> str:
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
