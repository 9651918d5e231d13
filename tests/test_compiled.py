from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from ttus_opt.compiled import compiled, source_stamp

CALLEE = """from ttus_opt.compiled import compiled

@compiled()
def step(x):
    return x + {step}
"""
CALLER = """from ttus_opt.compiled import compiled
from {name}.callee import step

@compiled()
def twice(x):
    return step(step(x))
"""


def test_compiles_and_leaves_numbas_folder_alone() -> None:
    before = numba.config.CACHE_DIR

    @compiled(nogil=True)
    def square(x: float) -> float:
        return x * x

    assert square(3.0) == 9.0
    assert before == numba.config.CACHE_DIR


def test_the_stamp_follows_every_compiled_file_and_no_other(tmp_path: Path) -> None:
    (tmp_path / "callee.py").write_text(CALLEE.format(step=1))
    (tmp_path / "plain.py").write_text("x = 1\n")
    first = source_stamp(tmp_path)
    (tmp_path / "plain.py").write_text("x = 2\n")
    assert source_stamp(tmp_path) == first
    (tmp_path / "callee.py").write_text(CALLEE.format(step=2))
    assert source_stamp(tmp_path) != first


@pytest.mark.slow
def test_a_changed_callee_is_not_haunted_by_its_old_code(tmp_path: Path) -> None:
    """The trap itself: the caller's file is the same, the callee's is not."""
    package = tmp_path / "haunted"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "caller.py").write_text(CALLER.format(name="haunted"))
    program = (
        "import ttus_opt.compiled as c; from pathlib import Path\n"
        f"c._HERE = Path({str(package)!r})\n"
        "from haunted.caller import twice; print(twice(0))"
    )
    for step in (1, 5):
        (package / "callee.py").write_text(CALLEE.format(step=step))
        os.utime(package / "callee.py", (1.0e9, 1.0e9))  # only the content tells
        out = subprocess.run(
            # Python keeps bytecode by a file's second and size: -B keeps none
            [sys.executable, "-B", "-c", program],
            capture_output=True,
            text=True,
            check=True,
            cwd=tmp_path,
            env={"PYTHONPATH": f"{tmp_path}:{Path.cwd()}", "HOME": str(tmp_path)},
        )
        assert int(out.stdout) == 2 * step
