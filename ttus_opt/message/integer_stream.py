"""Whole numbers as bytes, by pcodec, dense or sparse, whichever is shorter.

The receiver knows their count in advance and decodes into an array of that length;
anything that does not fill it exactly is damaged.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.core.optional import load
from ttus_opt.message.envelope import Reader, Writer

DENSE, SPARSE = 0, 1

#: Highest compression level of pcodec: the arrays are small
LEVEL = 12

DAMAGED = "the message is damaged: its numbers cannot be decoded: ask for it again"


def write_integers(writer: Writer, values: IntArray) -> None:
    """Append numbers within 32 bits, shape (n,)."""
    at = np.flatnonzero(values)
    gaps = np.diff(at, prepend=-1)
    dense = _compressed(values)
    sparse = (_compressed(gaps), _compressed(values[at])) if len(at) else (b"", b"")
    if len(dense) + 1 <= sum(map(len, sparse)) + 6:
        writer.number("B", DENSE)
        writer.block(dense)
        return
    writer.number("B", SPARSE)
    writer.number("I", len(at))
    for block in sparse:
        writer.block(block)


def read_integers(reader: Reader, count: int) -> IntArray:
    """Numbers that `write_integers` appended, shape (count,).

    Raises:
        InputError: They are damaged or of another count.
        MissingPackageError: pcodec is not installed.
    """
    kind = reader.number("B")
    if kind == DENSE:
        return _expanded(reader.block(), count).astype(np.int64)
    if kind != SPARSE:
        raise InputError(DAMAGED)
    some = reader.number("I")
    if some > count:
        raise InputError(DAMAGED)
    values = np.zeros(count, np.int64)
    gaps, numbers = reader.block(), reader.block()
    if some == 0:
        return values
    steps = _expanded(gaps, some).astype(np.int64)
    at = np.cumsum(steps) - 1
    if (steps < 1).any() or at[-1] >= count:
        raise InputError(DAMAGED)
    values[at] = _expanded(numbers, some)
    return values


def _compressed(values: IntArray) -> bytes:
    pcodec: Any = load("pcodec", "sensors")
    config = pcodec.ChunkConfig(
        compression_level=LEVEL,
        mode_spec=pcodec.ModeSpec.classic(),
        delta_spec=pcodec.DeltaSpec.no_op(),
    )
    numbers = np.ascontiguousarray(values, dtype=np.int32)
    return bytes(pcodec.standalone.simple_compress(numbers, config))


def _expanded(block: bytes, count: int) -> NDArray[np.int32]:
    """Decoded numbers, shape (count,).

    Raises:
        InputError: The block is damaged or holds another count.
    """
    pcodec: Any = load("pcodec", "sensors")
    numbers = np.zeros(count, np.int32)
    try:
        progress = pcodec.standalone.simple_decompress_into(block, numbers)
    except (RuntimeError, TypeError, ValueError) as error:
        raise InputError(DAMAGED) from error
    if progress.n_processed != count or not progress.finished:
        raise InputError(DAMAGED)
    return numbers
