"""Claims: one process makes a file, the others wait for it."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import pytest

from ttus_opt.core.claims import Claims

pytest.importorskip("fcntl", reason="no locks on files here")


def waits(path: Path) -> threading.Thread:
    """A thread that claims a file and gives it back."""

    def work() -> None:
        claims = Claims()
        claims.take(path)
        claims.release()

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(0.1)
    return thread


def test_the_second_waits_until_the_first_gives_back(tmp_path: Path) -> None:
    claims, path = Claims(), tmp_path / "code"
    claims.take(path)
    claims.take(path)  # nothing more
    second = waits(path)
    assert second.is_alive()
    assert not waits(tmp_path / "other").is_alive()
    claims.release()
    second.join(10.0)
    assert not second.is_alive()
    assert not list(tmp_path.iterdir())


def test_a_claim_ends_with_its_process(tmp_path: Path) -> None:
    program = """
import sys, time
from pathlib import Path
from ttus_opt.core.claims import Claims
claims = Claims()
claims.take(Path(sys.argv[1]))
print("taken", flush=True)
time.sleep(60)
"""
    command = [sys.executable, "-c", program, str(tmp_path / "code")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "taken\n"
        second = waits(tmp_path / "code")
        assert second.is_alive()
        holder.kill()
    second.join(10.0)
    assert not second.is_alive()


def test_where_nothing_can_be_locked_nobody_waits(tmp_path: Path) -> None:
    claims = Claims()
    claims.take(tmp_path / "no such folder" / "code")
    assert not claims._held
    claims.release()
    assert not list(tmp_path.iterdir())
