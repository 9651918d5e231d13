"""The checksum that a file of this package ends in.

A flipped bit in a netCDF file changes a value silently, or lets the netCDF library run
on and on. So the file ends in a checksum of all bytes before, which is compared before
the library reads them. HDF5 permits bytes after its own; a program that writes the file
anew leaves them out.
"""

from __future__ import annotations

import zlib
from pathlib import Path

from ttus_opt.core.errors import InputError

#: What the file ends in: this, and the CRC-32 of all bytes before as 8 hex digits
SEAL = b"\nttus_opt crc32 "

#: Digits of a CRC-32, and bytes that are read at a time
DIGITS, AT_A_TIME = 8, 2**20


def seal(file: Path) -> None:
    """Append the checksum of all bytes."""
    digits = _crc(file, file.stat().st_size)
    with file.open("ab") as opened:
        opened.write(SEAL + digits)


def check_seal(file: Path) -> bool:
    """Compare a file with the checksum it ends in.

    Returns:
        Whether it has one.

    Raises:
        InputError: A byte is not what was written.
    """
    size = file.stat().st_size - len(SEAL) - DIGITS
    with file.open("rb") as opened:
        opened.seek(max(0, size))
        mark, digits = opened.read(len(SEAL)), opened.read()
    sealed = size >= 0 and mark == SEAL
    if sealed and digits != _crc(file, size):
        raise InputError(
            "its bytes are not what was written: the file is damaged, or another "
            "program changed it: copy or write it again"
        )
    return sealed


def _crc(file: Path, size: int) -> bytes:
    """CRC-32 of the first bytes, as hex digits."""
    crc = 0
    with file.open("rb") as opened:
        while part := opened.read(min(AT_A_TIME, size)):
            crc, size = zlib.crc32(part, crc), size - len(part)
    return b"%08x" % crc
