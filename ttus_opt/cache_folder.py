"""The folder that keeps machine code, which nobody else may write to."""

from __future__ import annotations

import functools
import os
import stat
import tempfile
import warnings
from pathlib import Path

import numba


@functools.cache
def cache_folder() -> Path | None:
    """Where machine code is kept: the user's cache, else a private temporary folder.

    What lies there is run, so it must belong to the user and be writable to no one
    else. A folder that the user has set (``NUMBA_CACHE_DIR``) may also be the
    administrator's, who compiled ahead for all.
    """
    chosen = numba.config.CACHE_DIR
    if chosen:
        folder = Path(chosen) / "ttus_opt"
        if _made(folder) and _trusted(folder, owners=(0,)):
            return folder
        warnings.warn(
            f"{folder} is not used for compiled code: it cannot be created, or others "
            "may write to it: change its owner and mode, or NUMBA_CACHE_DIR",
            RuntimeWarning,
            stacklevel=2,
        )
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    for folder in (
        home / "ttus_opt" / "compiled",
        Path(tempfile.gettempdir()) / f"ttus_opt-{user}",
    ):
        if _private(folder):
            return folder
    warnings.warn(
        f"compiled code is not saved: {home} is not writable; set NUMBA_CACHE_DIR to "
        "a writable folder",
        RuntimeWarning,
        stacklevel=2,
    )
    return None


def _private(folder: Path) -> bool:
    """Make a folder, and say whether this user and no other may write to it."""
    return _made(folder) and _trusted(folder) and os.access(folder, os.W_OK)


def _made(folder: Path) -> bool:
    """Make a folder for this user alone, where it is not there yet."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
    except OSError:
        return False
    return True


def _trusted(folder: Path, owners: tuple[int, ...] = ()) -> bool:
    """Whether nobody but this user, or these, can have put anything there."""
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode):  # a link goes where others want it to
        return False
    if not hasattr(os, "getuid"):
        return True
    return status.st_uid in (os.getuid(), *owners) and not status.st_mode & 0o022
