"""What a stamp tells of functions in files of their own: `tests/test_compiled.py`."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from ttus_opt.compiled import compiled
from ttus_opt.content_stamp import content_stamp

STAMPS = """
import importlib, pathlib, numba, ttus_opt
from ttus_opt.content_stamp import content_stamp
root = pathlib.Path(ttus_opt.__file__).parent
for path in sorted(root.rglob("*.py")):
    if "import compiled\\n" not in path.read_text():
        continue
    parts = path.relative_to(root.parent).with_suffix("").parts
    module = importlib.import_module(".".join(parts))
    for name, value in vars(module).items():
        if isinstance(value, numba.core.dispatcher.Dispatcher):
            print(module.__name__, name, content_stamp(value))
"""


def test_every_compiled_function_has_one_stamp_in_all_processes() -> None:
    """The order of a set, in which options are given, is another in each."""
    other = subprocess.run(
        [sys.executable, "-c", STAMPS],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONHASHSEED": "1", "PYTHONPATH": str(Path.cwd())},
    ).stdout.splitlines()
    here = io.StringIO()
    with contextlib.redirect_stdout(here):  # as a rule with a seed of its own
        exec(STAMPS, {})
    assert other == here.getvalue().splitlines()
    assert len(other) > 100


def test_a_slice_is_told_by_its_ends() -> None:
    """Python 3.14 keeps ``x[:3]`` as a constant of the function."""

    def stamp(part: slice) -> str:
        @compiled()
        def function(x: Any) -> Any:
            return x[part]

        return content_stamp(function)

    assert stamp(slice(None, 3)) == stamp(slice(None, 3)) != stamp(slice(None, 4))


def test_a_global_that_cannot_be_told_is_refused() -> None:
    reads = object()

    @compiled()
    def function() -> bool:
        return reads is None

    with pytest.raises(TypeError, match="whose content cannot be told"):
        content_stamp(function)
