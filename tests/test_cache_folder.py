from __future__ import annotations

import os
from pathlib import Path

import numba
import pytest

from ttus_opt.cache_folder import cache_folder


def test_only_a_private_folder_is_trusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "tmp"))
    chosen = cache_folder.__wrapped__
    mine = chosen()
    assert mine == tmp_path / "home" / "ttus_opt" / "compiled"
    assert mine.stat().st_mode & 0o777 == 0o700
    mine.chmod(0o777)  # another user may have put code here
    other = chosen()
    assert other is not None and other.parent == tmp_path / "tmp"
    other.rmdir()
    other.symlink_to(mine)
    with pytest.warns(RuntimeWarning, match="set NUMBA_CACHE_DIR"):
        assert chosen() is None


def test_a_chosen_folder_that_others_may_write_to_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As NUMBA_CACHE_DIR=/tmp would be, where someone else was first."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "shared"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    choose = cache_folder.__wrapped__
    folder = choose()
    assert folder == tmp_path / "shared" / "ttus_opt"
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o770)
    with pytest.warns(RuntimeWarning, match="others may write to it"):
        assert choose() == tmp_path / "home" / "ttus_opt" / "compiled"
    folder.chmod(0o755)
    assert choose() == folder
    owner = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: owner + 1)  # now it is another's
    if owner != 0:  # the administrator's is trusted
        with pytest.warns(RuntimeWarning, match="others may write to it"):
            choose()
    else:
        assert choose() == folder
