"""Reading and writing files without ever leaving half of one behind.

netCDF goes through xarray; every file of ours carries the attributes
``ttus_opt_kind`` and ``ttus_opt_version`` so that a file of another kind or of a
later version is refused with a sentence instead of a traceback.
"""

from __future__ import annotations

import contextlib
import datetime
import importlib.metadata
import os
import platform
import secrets
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from ttus_opt.errors import FileError, InputError

if TYPE_CHECKING:
    import xarray as xr


def existing_file(path: str | os.PathLike[str], what: str) -> Path:
    """Check that ``path`` is a readable, non-empty file.

    Args:
        path: The file.
        what: What the file should be, for the message ("trajectory").

    Returns:
        The path.

    Raises:
        FileError: It is missing, a folder, or empty.
    """
    file = Path(path)
    if not file.exists():
        raise FileError(f"{what} file not found: {file}: check the path")
    if file.is_dir():
        raise FileError(f"{what} {file} is a folder: name a file in it")
    if file.stat().st_size == 0:
        raise FileError(f"{what} file {file} is empty: record or export it again")
    return file


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path that takes the place of ``path`` on success only.

    Args:
        path: Where the finished file shall be; its folder is made when missing.

    Yields:
        A path beside it, with the same suffix, to write to.

    Raises:
        FileError: The folder cannot be made or written to.
    """
    target = Path(path)
    unique = f".{target.stem}-{secrets.token_hex(8)}{target.suffix}"
    temporary = target.parent / unique
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        # made here with the mode of any new file, so that the umask applies: reading
        # it means to change it, for every thread
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise FileError(
            f"cannot write {target}: {error.strerror or error}: choose another folder"
        ) from error
    try:
        yield temporary
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def provenance() -> dict[str, str]:
    """Who wrote a file and when, as netCDF attributes."""
    try:
        version = importlib.metadata.version("ttus-opt")
    except importlib.metadata.PackageNotFoundError:  # run from a plain checkout
        version = "unknown"
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {
        "source": f"ttus_opt {version}, Python {platform.python_version()}",
        "history": f"{now} written",
    }


def write_dataset(
    dataset: xr.Dataset, path: str | os.PathLike[str], *, kind: str, version: int
) -> None:
    """Write a dataset as netCDF with its kind, version and provenance.

    Args:
        dataset: What to write; every variable carries ``units``.
        path: The file; replaced only when the writing succeeded.
        kind: What the file holds ("surface", "field").
        version: Version of that kind's layout.
    """
    stamped = dataset.assign_attrs(
        ttus_opt_kind=kind, ttus_opt_version=version, **provenance()
    )
    with replacing(path) as temporary:
        stamped.to_netcdf(temporary, engine="netcdf4")


def read_dataset(
    path: str | os.PathLike[str], *, kind: str, version: int, foreign: bool = False
) -> xr.Dataset:
    """Read a netCDF file of a kind into memory.

    Args:
        path: The file.
        kind: What the file must hold.
        version: The newest version of that layout this code knows.
        foreign: Accept a file from elsewhere that carries no kind at all.

    Returns:
        The dataset, loaded, the file closed again.

    Raises:
        FileError: Missing, not netCDF, another kind, or another version.
    """
    file = existing_file(path, kind)
    import xarray as xr

    try:
        with warnings.catch_warnings():
            # numpy 2.4 warns inside netCDF4's compiled reader about array shapes
            warnings.simplefilter("ignore", DeprecationWarning)
            with xr.open_dataset(file, engine="netcdf4") as opened:
                dataset = opened.load()
    except (OSError, ValueError, RuntimeError, KeyError) as error:
        raise FileError(
            f"{file} is not a readable netCDF file ({type(error).__name__}): "
            f"truncated, or not a {kind} file?"
        ) from error
    found = dataset.attrs.get("ttus_opt_kind")
    if found is None and foreign:
        return dataset
    if found != kind:
        raise FileError(
            f"{file} holds {found or 'no ttus_opt data'}, expected a {kind}: "
            "wrong file?"
        )
    given = int(dataset.attrs.get("ttus_opt_version", -1))
    if given != version:
        raise FileError(
            f"{file} is {kind} version {given}, this ttus_opt reads version "
            f"{version}: {'update ttus_opt' if given > version else 'write it again'}"
        )
    return dataset


def array_of(
    dataset: xr.Dataset, name: str, dims: tuple[str, ...], units: str
) -> NDArray[Any]:
    """A variable's values, its dimensions and units being those expected.

    Args:
        dataset: What was read.
        name: The variable.
        dims: Its dimensions, in order.
        units: Its unit, as it was written.

    Returns:
        The values.

    Raises:
        InputError: It is not there, or has other dimensions or units.
    """
    if name not in dataset.variables:
        raise InputError(f"it has no variable {name}")
    found = dataset[name]
    if found.dims != dims:
        raise InputError(
            f"{name} has dimensions ({', '.join(map(str, found.dims))}), expected "
            f"({', '.join(dims)})"
        )
    given = found.attrs.get("units")
    if given != units:
        raise InputError(
            f"{name} has units {given!r}, expected {units!r}: convert it and state "
            "the unit"
        )
    return found.to_numpy()
