"""Read and write files; a failed write never leaves a partial file.

netCDF files written by this package carry the attributes ``ttus_opt_kind`` and
``ttus_opt_version``, so that a file of another kind or a later version is refused
with a clear message instead of a traceback.

They end in a checksum of all bytes before, which is compared before the netCDF library
reads them: a flipped bit changes a value silently, or lets that library run on and on.
HDF5 permits bytes after its own; a program that writes the file anew leaves them out.
"""

from __future__ import annotations

import codecs
import contextlib
import datetime
import glob
import hashlib
import logging
import math
import numbers
import os
import secrets
import shutil
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.core.errors import FileError, InputError, TtusWarning, located
from ttus_opt.core.interrupts import signals_deferred as signals_deferred

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr
    from numpy.typing import NDArray

    from ttus_opt.core.netcdf_file import Content as Content

#: Longest value of a file that an error shows [characters]
LONGEST_VALUE = 40

#: What tells text from other files [byte]
HEAD = 4096

LOG = logging.getLogger(__name__)

#: What the file ends in: this, and the CRC-32 of all bytes before as 8 hex digits
SEAL = b"\nttus_opt crc32 "

#: Digits of a CRC-32, and bytes that are read at a time
DIGITS, AT_A_TIME = 8, 2**20

#: What the netCDF library raises for a damaged file, by what is damaged
UNREADABLE = (OSError, ValueError, RuntimeError, KeyError, AttributeError)


def existing_file(
    path: str | os.PathLike[str], what: str, largest: float = math.inf
) -> Path:
    """The path of a file, after a check that it exists and is not empty.

    Args:
        path: The file.
        what: What the file should contain, for the message ("trajectory").
        largest: Largest accepted size [byte].

    Raises:
        FileError: It is missing, a folder, empty, or too large.
    """
    file = Path(path)
    if not file.exists():
        raise FileError(f"{what} file not found: {file}: check the path")
    if file.is_dir():
        raise FileError(f"{what} {file} is a folder: name a file in it")
    size = file.stat().st_size
    if size == 0:
        raise FileError(f"{what} file {file} is empty: record or export it again")
    if size > largest:
        raise FileError(f"{file} is too large for a {what} file: wrong file?")
    LOG.debug("reads %s as a %s, %d bytes", file, what, size)
    return file


def read_text(file: Path) -> str:
    """Text of a file in UTF-8, without its byte-order mark.

    Raises:
        FileError: It is not such text; told from its beginning, whatever its size.
    """
    try:
        with file.open("rb") as stream:
            head = stream.read(HEAD)
        text = "" if b"\0" in head else file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        text = ""
    except OSError as error:
        raise FileError(f"{file} cannot be read: {error.strerror}") from error
    if text or not head:
        return text
    if head[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        raise FileError(f"{file} is text in UTF-16: save it in UTF-8")
    raise FileError(f"{file} is not a text file: export it as text in UTF-8")


def read_npy(file: Path) -> NDArray[Any]:
    """Read a numeric array from an NPY file.

    Raises:
        FileError: The file is damaged or holds something other than numbers.
    """
    import numpy as np

    try:
        # memory-mapped: a header that announces too large an array allocates nothing
        values = np.lib.format.open_memmap(file, mode="r")
    except Exception as error:  # numpy raises nearly every class on damaged headers
        raise FileError(
            f"{file} does not read as a NPY array ({type(error).__name__}): truncated "
            "or damaged? save it again"
        ) from error
    if values.dtype.kind not in "iuf":
        raise FileError(f"{file} holds {values.dtype}, expected numbers: save it again")
    return np.array(values)


def sha256(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes, or of a folder's by name, in hexadecimal digits."""
    place = Path(path)
    if place.is_dir():
        files = sorted(file for file in place.rglob("*") if file.is_file())
        return hashlib.sha256("".join(map(sha256, files)).encode()).hexdigest()
    with place.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def check_output(
    path: str | os.PathLike[str],
    *,
    inputs: Sequence[str | os.PathLike[str]] = (),
    force: bool = False,
    size: int = 0,
) -> None:
    """Check, before any work is done, that an output file can be written.

    Args:
        path: The output file; symbolic links are followed.
        inputs: Input files, which must not be overwritten.
        force: Allow ``path`` to be one of the inputs.
        size: Approximate size of the output [byte].

    Raises:
        FileError: ``path`` is a folder, a device or one of the inputs, its folder is
            not writable, or the disk is too full.
    """
    try:
        target = Path(os.path.realpath(path))
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            target.stat()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise FileError(f"cannot write {path}: {why}: choose another name") from error
    if target.is_dir():
        raise FileError(f"cannot write {path}: it is a folder: name a file in it")
    if target.exists() and not target.is_file():
        raise FileError(
            f"cannot write {path}: it is not a regular file: choose another name"
        )
    if not force and target.exists():
        same = [i for i in inputs if Path(i).exists() and target.samefile(i)]
        if same:
            raise FileError(
                f"{path} would overwrite the input {same[0]}: choose another output, "
                "or pass force=True"
            )
    folder = target.parent
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise FileError(f"cannot write {path}: {folder} is not a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FileError(f"cannot write {path}: no permission in {folder}")
    free = shutil.disk_usage(folder).free
    if free < size:
        raise FileError(
            f"cannot write {path}: it takes about {size / 2**20:.0f} MiB and "
            f"{free / 2**20:.0f} MiB are free: make room or choose another folder"
        )


def made_folder(path: Path) -> Path:
    """The folder itself, created if missing; a `FileError` if that fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f"cannot write to {path}: {error.strerror or error}: choose another folder"
        ) from error
    return path


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write to a temporary file that replaces ``path`` only on success.

    Args:
        path: The final file; a missing folder is created, symbolic links are followed.

    Yields:
        The temporary file, in the same folder and with the same suffix.

    Raises:
        FileError: As `check_output`, the folder cannot be created, or writing failed;
            an existing file is left as it was.
    """
    check_output(path)
    target = Path(os.path.realpath(path))
    begin = f".{target.stem}-{_machine()}-"
    unique = f"{begin}{os.getpid()}-{secrets.token_hex(8)}{target.suffix}"
    temporary = target.parent / unique
    _remove_abandoned(target.parent, begin)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        # created with the default mode so that the umask applies; reading the umask
        # would mean changing it for every thread
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise FileError(
            f"cannot write {target}: {error.strerror or error}: choose another folder"
        ) from error
    try:
        yield temporary
        size = temporary.stat().st_size
        temporary.replace(target)
        LOG.info("wrote %s, %d bytes", path, size)
    except FileError:
        raise
    except OSError as error:
        if error.filename not in (None, str(temporary)):
            raise  # another file's
        raise FileError(
            f"cannot write {path}: {error.strerror or error}: make room or choose "
            "another folder; nothing was replaced"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def _machine() -> str:
    """Tells this machine's processes from those of others that share the folder."""
    import platform

    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


def _remove_abandoned(folder: Path, begin: str) -> None:
    """Remove temporary files of an output whose writers were killed on this machine."""
    for file in folder.glob(f"{glob.escape(begin)}*"):
        import psutil  # only where there is one

        number = file.name.removeprefix(begin).partition("-")[0]
        with contextlib.suppress(OSError, OverflowError):
            if number.isdecimal() and not psutil.pid_exists(int(number)):
                file.unlink()


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


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a UTF-8 text file by way of `replacing`."""
    write_bytes(path, text.encode())


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file by way of `replacing`."""
    with signals_deferred(), replacing(path) as temporary:
        temporary.write_bytes(content)


def provenance() -> dict[str, str]:
    """The netCDF attributes that state which program wrote a file and when."""
    import platform

    from ttus_opt.core.optional import version_of

    version, python = version_of("ttus-opt"), platform.python_version()
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {
        "source": f"ttus_opt {version}, Python {python}",
        "history": f"{now} written",
    }


def write_dataset(
    dataset: xr.Dataset, path: str | os.PathLike[str], *, kind: str, version: int
) -> None:
    """Write a dataset as netCDF with its kind, version and provenance.

    Args:
        dataset: The data; every variable carries ``units``.
        path: The output file.
        kind: What the file holds ("surface", "field").
        version: Version of that kind's layout.

    Raises:
        FileError: The file cannot be written; an existing file is left as it was.
    """
    stamped = dataset.assign_attrs(
        ttus_opt_kind=kind, ttus_opt_version=version, **provenance()
    )
    with signals_deferred(), replacing(path) as temporary:
        try:
            stamped.to_netcdf(temporary, engine="netcdf4")
            seal(temporary)
        except (OSError, RuntimeError) as error:
            raise FileError(
                f"cannot write {path}: {error}: is the disk full? Nothing was replaced"
            ) from error


def content_of(
    path: str | os.PathLike[str], what: str, without: Sequence[str] = ()
) -> tuple[Content, bool]:
    """A netCDF file in memory, and whether its checksum says that it is whole.

    Args:
        path: The file; one without a checksum is read by a process of its own.
        what: What it should contain, for the message.
        without: Variables that may be skipped; ``*`` stands for all.

    Raises:
        FileError: It is missing, damaged, or not netCDF.
    """
    from ttus_opt.core import netcdf_file

    file = existing_file(path, what)
    with located(file, FileError):
        sealed = check_seal(file)
    try:
        if sealed:
            with signals_deferred():  # the library swallows what is raised within it
                return netcdf_file.contents(file, without), True
        return netcdf_file.contents_apart(file), False
    except UNREADABLE as error:
        raise FileError(
            f"{file} is not a readable netCDF file ({type(error).__name__}): "
            f"truncated, or not a {what} file?"
        ) from error


def read_content(
    path: str | os.PathLike[str],
    *,
    kind: str,
    version: int,
    foreign: bool = False,
    without: Sequence[str] = (),
) -> Content:
    """Read a netCDF file of one kind into memory.

    Args:
        path: The file.
        kind: What the file must hold.
        version: The version of that layout this code reads.
        foreign: Also accept a file of other origin, which states no kind.
        without: Variables to skip.

    Raises:
        FileError: The file is missing, damaged, not netCDF, or of another kind or
            version.
    """
    found, sealed = content_of(path, kind, without)
    if not (foreign and "ttus_opt_kind" not in found.attrs):
        _check_kind(found.attrs, path, kind, version)
    if not sealed:
        warnings.warn(
            f"{path} has no checksum, so damage may go unnoticed: it was written by "
            "another program, or an older ttus_opt",
            TtusWarning,
            stacklevel=3,
        )
    return found


def _check_kind(
    attrs: Mapping[Any, Any], file: str | os.PathLike[str], kind: str, version: int
) -> None:
    """`FileError` where a file is of another kind or version."""
    with located(file, FileError):
        found = text_of(attrs, "ttus_opt_kind", "no ttus_opt data")
    if found != kind:
        raise FileError(f"{file} holds {found}, expected a {kind}: wrong file?")
    given = attrs.get("ttus_opt_version")
    if not isinstance(given, numbers.Integral):
        raise FileError(f"{file} does not state its {kind} version")
    if (given := int(given)) != version:
        raise FileError(
            f"{file} is {kind} version {given}, this ttus_opt reads version "
            f"{version}: {'update ttus_opt' if given > version else 'write it again'}"
        )


def kind_of(path: str | os.PathLike[str], what: str) -> str | None:
    """The kind of a netCDF file ("surface", "field"); None if it states none.

    Args:
        path: The file.
        what: What the file should contain, for the message ("surface or field").

    Raises:
        FileError: The file is missing, damaged, or not netCDF.
    """
    kind = content_of(path, what, without=("*",))[0].attrs.get("ttus_opt_kind")
    return None if kind is None else str(kind)


def text_of(
    attributes: Mapping[str, Any], name: str, default: str | None = None
) -> str:
    """A text attribute of a file, or the default if the attribute is missing.

    Raises:
        InputError: The value is missing, empty, or not text.
    """
    found = attributes.get(name, default)
    if not (isinstance(found, str) and found):
        raise InputError(f"attribute {name} must be text, got {shortened(found)}")
    return found


def shortened(value: object) -> str:
    """A value as an error message shows it: on one line and cut to a short length.

    >>> shortened("a" * 200)
    "'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa…"
    """
    text = " ".join(repr(value).split())
    return text if len(text) <= LONGEST_VALUE else text[:LONGEST_VALUE] + "…"


def array_of(
    content: Content, name: str, dims: tuple[str, ...], units: str
) -> NDArray[Any]:
    """The values of a variable, after a check of its dimensions and units.

    Raises:
        InputError: The variable is missing or has other dimensions or units.
    """
    if name not in content.variables:
        raise InputError(f"it has no variable {name}")
    found = content.variables[name]
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
    return found.values


def as_numbers(name: str, values: Any) -> NDArray[np.float64]:
    """Convert the values of a variable or attribute to an array of numbers.

    Raises:
        InputError: They are not numbers, or lists of different lengths.
    """
    import numpy as np

    try:
        return np.array(values, dtype=np.float64)
    except (OverflowError, TypeError, ValueError):
        raise InputError(
            f"{name} must hold numbers, in rows of one length: save it again"
        ) from None


def mask(name: str, values: NDArray[Any]) -> NDArray[np.bool_]:
    """Convert a mask stored as 0 and 1 to booleans.

    Raises:
        InputError: It contains another value.
    """
    import numpy as np

    if not np.isin(values, (0, 1)).all():
        raise InputError(f"{name} must hold 0 and 1 only")
    return np.asarray(values, dtype=bool)
