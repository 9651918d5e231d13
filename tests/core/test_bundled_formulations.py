"""The bundled formulations are found, whatever else is called ``formulations``."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SHOW = (
    "from ttus_opt.problem.formulation import available; "
    "print('eq10' in {f.name for f in available()})"
)


@pytest.mark.slow
def test_a_users_own_file_of_that_name_changes_nothing(tmp_path):
    (tmp_path / "formulations.py").write_text("raise SystemExit('not ours')\n")
    script = tmp_path / "run.py"
    script.write_text(SHOW)
    done = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.stdout == "True\n", done.stderr


@pytest.mark.slow
def test_a_wheel_carries_them_inside_the_package(tmp_path):
    """Built and unpacked: no other top-level package, and eq10 is found."""
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps"]
    done = subprocess.run(
        [*build, "--wheel-dir", str(tmp_path), str(ROOT)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        tops = {name.split("/")[0] for name in archive.namelist()}
        archive.extractall(tmp_path / "site")
    assert {top for top in tops if not top.endswith(".dist-info")} == {"ttus_opt"}
    shown = subprocess.run(
        [sys.executable, "-c", SHOW],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(tmp_path / "site")},
        cwd=tmp_path,
    )
    assert shown.stdout == "True\n", shown.stderr
