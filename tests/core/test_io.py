import contextlib
import errno
import os
import signal
import stat
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr

from tests.kit import FileError, InputError, TtusWarning, python, refuses
from ttus_opt import example
from ttus_opt.core import io, netcdf_file
from ttus_opt.scan.surface import Surface
from ttus_opt.sensors.netcdf_stream import write_netcdf_wrenches
from ttus_opt.sensors.stream_files import read_wrenches
from ttus_opt.sensors.streams import WrenchStream


def dataset():
    return xr.Dataset({"a": ("x", np.arange(3.0), {"units": "m"})})


def test_round_trip_with_provenance(tmp_path):
    io.write_dataset(dataset(), tmp_path / "a.nc", kind="surface", version=1)
    back = io.read_content(tmp_path / "a.nc", kind="surface", version=1)
    np.testing.assert_array_equal(back.variables["a"].values, [0, 1, 2])
    assert back.variables["a"].attrs["units"] == "m"
    assert "ttus_opt" in back.attrs["source"]


def test_a_disk_that_fills_up_is_told_with_the_file(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    told = pytest.raises(
        FileError, match=r"cannot write .*a\.txt: No space left on dev"
    )
    with told, io.replacing(target) as temporary:
        temporary.write_text("half")
        raise full
    with pytest.raises(FileNotFoundError, match="elsewhere"), io.replacing(target):
        (tmp_path / "elsewhere").read_text()
    with pytest.raises(FileError, match="of the caller"), io.replacing(target):
        raise FileError("of the caller")
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def replaced_mode(target, umask):
    """Permissions of a file that was replaced under a umask."""
    before = os.umask(umask)
    try:
        with io.replacing(target) as temporary:
            temporary.write_text("new")
    finally:
        os.umask(before)
    return stat.S_IMODE(target.stat().st_mode)


@pytest.mark.parametrize(
    ("umask", "mode"), [(0o022, 0o644), (0o002, 0o664), (0o077, 0o600), (0, 0o666)]
)
def test_a_file_has_the_mode_of_any_new_file(tmp_path, umask, mode):
    assert replaced_mode(tmp_path / "a.txt", umask) == mode


def test_writing_leaves_the_umask_alone(tmp_path, monkeypatch):
    """It is the process's: another thread's file would be open to everyone."""

    def changed(mask):
        raise AssertionError("the umask was changed")

    monkeypatch.setattr(os, "umask", changed)
    with io.replacing(tmp_path / "a.txt") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "a.txt").read_text() == "new"


def test_many_writers_of_one_file_do_not_meet(tmp_path):
    target = tmp_path / "a.txt"
    with io.replacing(target) as first, io.replacing(target) as second:
        assert first != second
        first.write_text("first")
        second.write_text("second")
    assert target.read_text() == "first"  # the last to end
    assert list(tmp_path.iterdir()) == [target]


def test_a_folder_that_cannot_be_written_to_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    target = tmp_path / "file" / "a.txt"
    with (
        pytest.raises(FileError, match=r"cannot write .*is not a folder"),
        io.replacing(target),
    ):
        pass


def test_a_link_is_followed(tmp_path):
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to(tmp_path / "real.txt")
    with io.replacing(tmp_path / "link.txt") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real.txt").read_text() == "new"


def test_an_output_that_is_an_input_needs_force(tmp_path):
    (tmp_path / "scan.ply").write_text("precious")
    (tmp_path / "link.ply").symlink_to(tmp_path / "scan.ply")
    for output in ("scan.ply", "link.ply"):
        with pytest.raises(FileError, match="would overwrite the input"):
            io.check_output(tmp_path / output, inputs=[tmp_path / "scan.ply"])
        io.check_output(tmp_path / output, inputs=[tmp_path / "scan.ply"], force=True)


def test_a_pipe_and_a_folder_are_no_output(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with (
        pytest.raises(FileError, match="not a regular file"),
        io.replacing(tmp_path / "pipe"),
    ):
        pass
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    refuses(FileError, "is a folder", io.check_output, tmp_path)


def test_a_full_disk_is_told_before_the_work(tmp_path):
    io.check_output(tmp_path / "a.nc", size=1)
    refuses(FileError, "MiB are free", io.check_output, tmp_path / "a.nc", size=2**60)


def test_a_write_that_fails_is_one_line_and_keeps_the_old_file(tmp_path, monkeypatch):
    file = tmp_path / "a.nc"
    io.write_dataset(dataset(), file, kind="field", version=1)

    def full(*_, **__):
        raise RuntimeError("NetCDF: HDF error")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", full)
    with pytest.raises(FileError, match="HDF error: is the disk full"):
        io.write_dataset(dataset(), file, kind="field", version=1)
    monkeypatch.undo()
    assert "a" in io.read_content(file, kind="field", version=1).variables
    assert list(tmp_path.iterdir()) == [file]


def test_an_interrupt_while_a_file_is_read_is_not_lost(tmp_path, monkeypatch):
    """The netCDF library catches all that is raised where it looks for fillings."""
    file, read = tmp_path / "a.nc", netcdf_file.contents
    io.write_dataset(dataset(), file, kind="surface", version=1)

    def contents(*given):
        with contextlib.suppress(BaseException):
            signal.raise_signal(signal.SIGINT)
        return read(*given)

    monkeypatch.setattr(netcdf_file, "contents", contents)
    refuses(KeyboardInterrupt, "", io.read_content, file, kind="surface", version=1)


def test_kind_and_version_are_checked(tmp_path):
    file = tmp_path / "a.nc"
    io.write_dataset(dataset(), file, kind="surface", version=2)
    with pytest.raises(FileError, match="version 2, this ttus_opt reads version 1"):
        io.read_content(file, kind="surface", version=1)
    with pytest.raises(FileError, match="holds surface, expected a field"):
        io.read_content(file, kind="field", version=1)


@pytest.mark.parametrize(
    ("attributes", "told"),
    [
        ({"ttus_opt_kind": np.arange(2.0)}, "ttus_opt_kind must be text, got array"),
        ({"ttus_opt_kind": 5.0}, "ttus_opt_kind must be text, got np.float64"),
        ({"ttus_opt_version": "two"}, "does not state its surface version"),
        ({"ttus_opt_version": np.arange(2)}, "does not state its surface version"),
        ({"ttus_opt_version": 1.5}, "does not state its surface version"),
    ],
)
def test_stamps_of_another_type(tmp_path, attributes, told):
    file = tmp_path / "a.nc"
    stamped = {"ttus_opt_kind": "surface", "ttus_opt_version": 1, **attributes}
    dataset().assign_attrs(stamped).to_netcdf(file)
    with pytest.raises(FileError, match=told) as caught:
        io.read_content(file, kind="surface", version=1, foreign=True)
    assert "a.nc" in str(caught.value)


def test_a_file_from_elsewhere_is_read_only_where_allowed(tmp_path):
    file = tmp_path / "a.nc"
    dataset().to_netcdf(file)
    with pytest.warns(TtusWarning, match="has no checksum"):
        found = io.read_content(file, kind="surface", version=1, foreign=True)
    assert "a" in found.variables
    with pytest.raises(FileError, match="no ttus_opt data"):
        io.read_content(file, kind="field", version=1)


@pytest.mark.parametrize("content", [b"", b"CDF\x01 but then nothing", b"text"])
def test_unreadable_files_are_one_line(tmp_path, content):
    file = tmp_path / "a.nc"
    file.write_bytes(content)
    caught = refuses(FileError, "", io.read_content, file, kind="field", version=1)
    assert "a.nc" in caught


def test_an_attribute_that_hdf5_cannot_open_is_told(tmp_path, monkeypatch):
    """netCDF4 then raises an AttributeError: mutation 957 of a field file."""
    file = tmp_path / "field.nc"
    io.write_dataset(xr.Dataset({"a": ("x", [1.0])}), file, kind="field", version=1)

    def damaged(*args, **options):
        raise AttributeError("NetCDF: Can't open HDF5 attribute")

    monkeypatch.setattr(netCDF4, "Dataset", damaged)
    told = r"field\.nc is not a readable netCDF file"
    refuses(FileError, told, io.read_content, file, kind="field", version=1)


#: A number that stands for a missing one, unless a file says otherwise
FILLING = netCDF4.default_fillvals["i2"]


@pytest.mark.parametrize(
    ("last", "encoding"),
    [
        (np.nan, {"dtype": "f8"}),
        (np.nan, {"dtype": "f4", "_FillValue": -1.0}),
        (np.nan, {"dtype": "i2", "_FillValue": -9, "scale_factor": 0.5}),
        (np.nan, {"dtype": "i2", "missing_value": -9, "add_offset": 2.0}),
        (int(FILLING), {"dtype": "i2"}),
    ],
)
def test_variables_are_read_as_xarray_reads_them(tmp_path, last, encoding):
    values = np.array([[0, 1], [3, last]])  # of whole numbers where all are
    written = xr.Dataset({"a": (("x", "y"), values, {"units": "m"}), "b": 3})
    written["a"].encoding.update(encoding)
    io.write_dataset(written, tmp_path / "a.nc", kind="field", version=1)
    given = {"kind": "field", "version": 1}
    expected = xr.load_dataset(tmp_path / "a.nc", engine="netcdf4")
    found = io.read_content(tmp_path / "a.nc", **given, without=("b",))
    np.testing.assert_array_equal(found.variables["a"].values, expected["a"])
    np.testing.assert_array_equal(expected["a"], values)
    assert io.array_of(found, "a", ("x", "y"), "m") is found.variables["a"].values
    assert found.attrs == expected.attrs
    assert set(found.variables) == {"a"}


def test_missing_file_and_folder(tmp_path):
    refuses(FileError, "not found", io.existing_file, tmp_path / "no.nc", "field")
    refuses(FileError, "folder", io.existing_file, tmp_path, "field")


def test_the_kind_of_a_file(tmp_path):
    io.write_dataset(dataset(), tmp_path / "own.nc", kind="surface", version=1)
    dataset().to_netcdf(tmp_path / "foreign.nc")
    assert io.kind_of(tmp_path / "own.nc", "surface") == "surface"
    assert io.kind_of(tmp_path / "foreign.nc", "surface") is None
    (tmp_path / "text.nc").write_text("no netCDF")
    with pytest.raises(FileError, match=r"text\.nc is not a readable netCDF file"):
        io.kind_of(tmp_path / "text.nc", "surface")


def test_files_of_killed_writers_go_at_the_next_write(tmp_path):
    """Those of writers that run, here or on another machine, stay."""
    target = tmp_path / "a[1].txt"
    program = (
        "import os, sys\nfrom ttus_opt.core import io\n"
        "with io.replacing(sys.argv[1]) as file:\n"
        "    file.write_text('half')\n    os.kill(os.getpid(), 9)\n"
    )
    python("-c", program, target, status=-9)
    (left,) = tmp_path.iterdir()
    elsewhere = left.with_name(left.name.replace(io._machine(), "0" * 8))
    elsewhere.write_text("another machine's")
    numbered = left.name.removeprefix(f".a[1]-{io._machine()}-").partition("-")[0]
    unknown = left.with_name(left.name.replace(f"-{numbered}-", f"-{10**30}-"))
    unknown.write_text("of a process that cannot be asked for")
    with io.replacing(target) as mine:
        assert not left.exists()
        io.write_text(target, "other")
        assert mine.exists()
    assert sorted(tmp_path.iterdir()) == sorted([elsewhere, unknown, target])


# --------------------------------------------------------------- checksums


def kind(file):
    return io.kind_of(file, "surface")


def test_a_flipped_bit_is_noticed_before_the_library_reads(tmp_path):
    """One flip of such a file kept the netCDF library busy for ten minutes."""
    whole = Path(example.path("surface.nc")).read_bytes()
    sealed = len(whole) - len(io.SEAL) - io.DIGITS
    file = tmp_path / "damaged.nc"
    for bit in np.random.default_rng(0).integers(0, 8 * sealed, 100):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        file.write_bytes(damaged)
        refuses(InputError, "its bytes are not what was written", io.check_seal, file)


def test_a_file_without_a_seal_passes(tmp_path):
    for content in (b"", b"x", io.SEAL, b"another program's bytes" * 10):
        (file := tmp_path / "other").write_bytes(content)
        assert not io.check_seal(file)
    io.seal(file)
    assert io.check_seal(file)
    assert file.read_bytes().startswith(content + io.SEAL)


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
