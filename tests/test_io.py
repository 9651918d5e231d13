from __future__ import annotations

import os
import stat
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from ttus_opt import io
from ttus_opt.errors import FileError


def dataset() -> xr.Dataset:
    return xr.Dataset({"a": ("x", np.arange(3.0), {"units": "m"})})


def test_round_trip_with_provenance(tmp_path: Path) -> None:
    io.write_dataset(dataset(), tmp_path / "a.nc", kind="surface", version=1)
    back = io.read_dataset(tmp_path / "a.nc", kind="surface", version=1)
    np.testing.assert_array_equal(back["a"], [0, 1, 2])
    assert back["a"].attrs["units"] == "m"
    assert "ttus_opt" in back.attrs["source"]


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(RuntimeError), io.replacing(target) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def replaced_mode(target: Path, umask: int) -> int:
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
def test_a_file_has_the_mode_of_any_new_file(
    tmp_path: Path, umask: int, mode: int
) -> None:
    assert replaced_mode(tmp_path / "a.txt", umask) == mode


def test_writing_leaves_the_umask_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is the process's: another thread's file would be open to everyone."""

    def changed(mask: int) -> int:
        raise AssertionError("the umask was changed")

    monkeypatch.setattr(os, "umask", changed)
    with io.replacing(tmp_path / "a.txt") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "a.txt").read_text() == "new"


def test_many_writers_of_one_file_do_not_meet(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    with io.replacing(target) as first, io.replacing(target) as second:
        assert first != second
        first.write_text("first")
        second.write_text("second")
    assert target.read_text() == "first"  # the last to end
    assert list(tmp_path.iterdir()) == [target]


def test_a_folder_that_cannot_be_written_to_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    target = tmp_path / "file" / "a.txt"
    with (
        pytest.raises(FileError, match=r"cannot write .*choose another folder"),
        io.replacing(target),
    ):
        pass


def test_kind_and_version_are_checked(tmp_path: Path) -> None:
    file = tmp_path / "a.nc"
    io.write_dataset(dataset(), file, kind="surface", version=2)
    with pytest.raises(FileError, match="version 2, this ttus_opt reads version 1"):
        io.read_dataset(file, kind="surface", version=1)
    with pytest.raises(FileError, match="holds surface, expected a field"):
        io.read_dataset(file, kind="field", version=1)


def test_a_file_from_elsewhere_is_read_only_where_allowed(tmp_path: Path) -> None:
    file = tmp_path / "a.nc"
    dataset().to_netcdf(file)
    assert "a" in io.read_dataset(file, kind="surface", version=1, foreign=True)
    with pytest.raises(FileError, match="no ttus_opt data"):
        io.read_dataset(file, kind="field", version=1)


@pytest.mark.parametrize("content", [b"", b"CDF\x01 but then nothing", b"text"])
def test_unreadable_files_are_one_line(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "a.nc"
    file.write_bytes(content)
    with pytest.raises(FileError) as caught:
        io.read_dataset(file, kind="field", version=1)
    assert "\n" not in str(caught.value)
    assert "a.nc" in str(caught.value)


def test_truncated_netcdf_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.nc"
    io.write_dataset(dataset(), file, kind="field", version=1)
    file.write_bytes(file.read_bytes()[:-2000])
    with pytest.raises(FileError, match=r"a\.nc"):
        io.read_dataset(file, kind="field", version=1)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="not found"):
        io.existing_file(tmp_path / "no.nc", "field")
    with pytest.raises(FileError, match="folder"):
        io.existing_file(tmp_path, "field")
