import os

import numba
import pytest

from ttus_opt.core.cache_folder import cache_folder
from ttus_opt.core.errors import TtusWarning


def test_only_a_private_folder_is_trusted(tmp_path, monkeypatch):
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
    (tmp_path / "own").mkdir(mode=0o700)
    other.symlink_to(tmp_path / "own")  # or to wherever it points later
    with pytest.warns(TtusWarning, match="set NUMBA_CACHE_DIR"):
        assert chosen() is None


def test_what_cannot_be_made_or_written_to_is_passed_over(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "not" / "yet"))
    choose = cache_folder.__wrapped__
    folder = choose()
    assert folder is not None and folder.parent == tmp_path / "not" / "yet"
    assert folder.name == f"ttus_opt-{os.getuid()}"  # one of each user's
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.warns(TtusWarning, match="compiled code is not saved"):
        assert choose() is None
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "file"))
    with pytest.warns(TtusWarning) as warned:
        assert choose() is None
    assert "cannot be created" in str(warned[0].message)


def test_without_a_cache_of_the_user_s_own_it_lies_in_their_home(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("HOME", str(tmp_path))
    choose, expected = cache_folder.__wrapped__, tmp_path / ".cache/ttus_opt/compiled"
    for environment in ("", None):  # empty, which counts as not set, or not set
        if environment is None:
            monkeypatch.delenv("XDG_CACHE_HOME")
        else:
            monkeypatch.setenv("XDG_CACHE_HOME", environment)
        assert choose() == expected
    expected.chmod(0o770)
    with monkeypatch.context() as windows:
        windows.delattr(os, "getuid")  # where modes say nothing
        assert choose() == expected
    owner = os.getuid()
    expected.chmod(0o700)
    monkeypatch.setattr(os, "getuid", lambda: owner + 1)  # now it is another's
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    with pytest.warns(TtusWarning, match="compiled code is not saved"):
        assert choose() is None


def test_a_chosen_folder_that_others_may_write_to_is_not_used(tmp_path, monkeypatch):
    """As NUMBA_CACHE_DIR=/tmp would be, where someone else was first."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "shared"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    choose = cache_folder.__wrapped__
    folder = choose()
    assert folder == tmp_path / "shared" / "ttus_opt"
    assert folder.stat().st_mode & 0o777 == 0o700
    for mode in (0o720, 0o702):
        folder.chmod(mode)
        with pytest.warns(TtusWarning, match="others may write to it"):
            choose()
    folder.chmod(0o777)
    with pytest.warns(TtusWarning, match="others may write to it"):
        assert choose() == tmp_path / "home" / "ttus_opt" / "compiled"
    folder.chmod(0o755)
    assert choose() == folder
    owner = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: owner + 1)  # now it is another's
    if owner != 0:  # the administrator's is trusted
        with pytest.warns(TtusWarning, match="others may write to it"):
            choose()
    else:
        assert choose() == folder
