"""Stamps; those of functions in files of their own: `tests/core/test_compiled.py`."""

from __future__ import annotations

import contextlib
import io
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from ttus_opt.core.compiled import compiled
from ttus_opt.core.content_stamp import content_stamp

STAMPS = """
import importlib, pathlib, numba, ttus_opt
from ttus_opt.core.content_stamp import content_stamp
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


def reading(value: Any) -> Any:
    """A function that reads a value from around it."""

    @compiled()
    def function() -> Any:
        return value

    return function


def pair(*names: str) -> Any:
    return NamedTuple("pair", [(name, int) for name in names])  # type: ignore[misc]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ((1, (2, 3)), ((1, 2), 3)),
        (np.zeros(2), np.ones(2)),
        (np.zeros(2), np.zeros(2, np.int64)),  # the same bytes
        (np.zeros((2, 3)), np.zeros((3, 2))),
        (np.sin, np.cos),
        (math.sin, math.cos),
        (np.dtype("f4"), np.dtype("f8")),
        (math, np),
        ({"a": 1}, {"a": 2}),
        (1, np.int64(1)),
        (pair("first", "second"), pair("second", "first")),
        (int, float),
    ],
)
def test_a_value_that_is_read_is_told(one: Any, other: Any) -> None:
    assert content_stamp(reading(one)) == content_stamp(reading(one))
    assert content_stamp(reading(one)) != content_stamp(reading(other))


def test_the_order_of_a_set_or_a_dictionary_is_none() -> None:
    one, other = {"a": 1, "b": 2}, {"b": 2, "a": 1}
    assert content_stamp(reading(one)) == content_stamp(reading(other))


#: A function, and what in it another has otherwise
SOURCES = [
    ("(x, y=1): return x + y", "y=1", "y=2"),
    ("(x, *, y=1): return x + y", "y=1", "y=2"),
    ("(x): return x.first", "first", "second"),
    ("(x): return x + x", "+", "*"),
    ("(x): return [i + 1 for i in x]", "1", "2"),
    ("(x): return function(x - 1) if x else 1", "- 1", "- 2"),
    (
        "(x): return function(x - 1) if x else other(x)",
        "x else other",
        "not x else other",
    ),
    ("(x): return other(function(x))", "other(function", "function(other"),
]


@pytest.mark.parametrize(("source", "part", "by"), SOURCES)
def test_a_function_is_told_by_what_it_does(source: str, part: str, by: str) -> None:
    """Also one that calls itself, or another that calls it."""

    def stamp(source: str) -> str:
        names: dict[str, Any] = {"__name__": "elsewhere"}
        exec(f"def function{source}\ndef other(x): return function(x)", names)
        for name in ("function", "other"):
            names[name] = compiled()(names[name])
        return content_stamp(names["function"])

    assert part in source
    assert stamp(source) == stamp(source) != stamp(source.replace(part, by))


def test_options_are_told_by_their_values() -> None:
    def function(x: float) -> float:
        return x

    options: list[Any] = [{"contract"}, {"reassoc"}, {"contract", "reassoc"}, True]
    made = [compiled(fastmath=option)(function) for option in options]
    assert len({content_stamp(one) for one in made}) == len(made)


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

    with pytest.raises(TypeError, match="whose content cannot be identified"):
        content_stamp(function)
