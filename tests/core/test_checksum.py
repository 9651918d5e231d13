"""Damage of a file is noticed."""

from pathlib import Path

import numpy as np
import pytest

from tests.refusals import refuses
from ttus_opt import example
from ttus_opt.core.checksum import DIGITS, SEAL, check_seal, seal
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.core.io import kind_of
from ttus_opt.scan.surface import Surface
from ttus_opt.sensors.netcdf_stream import write_netcdf_wrenches
from ttus_opt.sensors.stream_files import read_wrenches
from ttus_opt.sensors.streams import WrenchStream


def kind(file):
    return kind_of(file, "surface")


def test_a_flipped_bit_is_noticed_before_the_library_reads(tmp_path):
    """One flip of such a file kept the netCDF library busy for ten minutes."""
    whole = Path(example.path("surface.nc")).read_bytes()
    sealed = len(whole) - len(SEAL) - DIGITS
    file = tmp_path / "damaged.nc"
    for bit in np.random.default_rng(0).integers(0, 8 * sealed, 100):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        file.write_bytes(damaged)
        refuses(InputError, "its bytes are not what was written", check_seal, file)


def test_a_file_without_a_seal_passes(tmp_path):
    for content in (b"", b"x", SEAL, b"another program's bytes" * 10):
        (file := tmp_path / "other").write_bytes(content)
        assert not check_seal(file)
    seal(file)
    assert check_seal(file)
    assert file.read_bytes().startswith(content + SEAL)


@pytest.mark.parametrize("read", [Surface.load, read_wrenches, kind])
def test_every_reader_compares_the_bytes(read, tmp_path):
    file = tmp_path / "surface.nc"
    content = bytearray(Path(example.path("surface.nc")).read_bytes())
    content[len(content) // 2] ^= 4
    file.write_bytes(content)
    refuses(FileError, "its bytes are not what was written", read, file)


def test_wrenches_are_written_with_a_seal(tmp_path):
    file = tmp_path / "wrenches.nc"
    time = np.arange(4.0)
    write_netcdf_wrenches(WrenchStream(time, np.ones((4, 3)), None), file)
    np.testing.assert_array_equal(read_wrenches(file).time, time)
    content = file.read_bytes()
    at = content.index(np.float64(1.0).tobytes())
    file.write_bytes(content[:at] + b"\1" + content[at + 1 :])
    refuses(FileError, "its bytes are not what was written", read_wrenches, file)
