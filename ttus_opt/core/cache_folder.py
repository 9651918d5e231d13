"""The folder that stores machine code, which nobody else may write to."""

from __future__ import annotations

import functools
import os
import stat
import tempfile
from pathlib import Path

import numba
import platformdirs

from ttus_opt.core.errors import warn


@functools.cache
def cache_folder() -> Path | None:
    """The folder for machine code: the user's cache, else a private temporary folder.

    Its content is executed, so the folder must belong to the user and be writable by
    no one else. A folder set by the user (``NUMBA_CACHE_DIR``) may also belong to the
    administrator, who has compiled ahead for all users.
    """
    chosen = numba.config.CACHE_DIR
    if chosen:
        folder = Path(chosen) / "ttus_opt"
        if _trusted(folder, owners=(0,)):
            return folder
        warn(
            f"{folder} is not used for compiled code: it cannot be created, or others "
            "may write to it: change its owner and mode, or NUMBA_CACHE_DIR"
        )
    home = platformdirs.user_cache_path("ttus_opt", appauthor=False)
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    temporary = Path(tempfile.gettempdir()) / f"ttus_opt-{user}"
    for folder in (home / "compiled", temporary):
        if _trusted(folder) and os.access(folder, os.W_OK):
            return folder
    warn(
        f"compiled code is not saved: {home} is not writable; set NUMBA_CACHE_DIR to "
        "a writable folder"
    )
    return None


def _trusted(folder: Path, owners: tuple[int, ...] = ()) -> bool:
    """Whether only this user, or one of the given owners, can have written there.

    A missing folder is created for this user alone.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return False
    if not stat.S_ISDIR(status.st_mode):  # others can redirect a symbolic link
        return False
    if not hasattr(os, "getuid"):
        return True
    return status.st_uid in (os.getuid(), *owners) and not status.st_mode & 0o022
