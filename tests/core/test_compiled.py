from __future__ import annotations

import gc
import importlib
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba.core import event

import ttus_opt.core.compiled as kept
from tests.conftest import some
from ttus_opt.core.cache_folder import cache_folder
from ttus_opt.core.claims import Claims
from ttus_opt.core.compiled import compiled, is_kept
from ttus_opt.core.content_stamp import content_stamp

PACKAGE = {
    "__init__": "",
    "sizes": "STEP = 1\n",
    "pair": """from typing import NamedTuple

class Pair(NamedTuple):
    first: int
    second: int
""",
    "innermost": """from ttus_opt.core.compiled import compiled
from haunted import sizes

@compiled()
def least(x):
    return x + sizes.STEP
""",
    "callee": """from ttus_opt.core.compiled import compiled
from haunted.innermost import least

FACTOR = 1

@compiled()
def step(x):
    return least(x) * FACTOR

@compiled()
def aside(x):
    '''Nothing calls this.'''
    return x
""",
    "caller": """from ttus_opt.core.compiled import compiled
from haunted.callee import step

@compiled()
def twice(x):
    return step(step(x))

@compiled()
def first(pair):
    return pair.first
""",
}

Load = Callable[..., Any]


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Load]:
    """Load the package anew, with edits, as a new process would: (file, old, new)."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # it goes by a file's second
    cache_folder.cache_clear()

    def forget() -> None:
        for name in [name for name in sys.modules if name.split(".")[0] == "haunted"]:
            del sys.modules[name]

    def load(*edits: tuple[str, str, str], checkout: str = "here") -> Any:
        folder = tmp_path / checkout / "haunted"
        folder.mkdir(parents=True, exist_ok=True)
        content = dict(PACKAGE)
        for file, old, new in edits:
            assert old in content[file]
            content[file] = content[file].replace(old, new)
        for file, text in content.items():
            (folder / f"{file}.py").write_text(text)
        forget()
        importlib.invalidate_caches()
        with monkeypatch.context() as path:
            path.syspath_prepend(tmp_path / checkout)
            return importlib.import_module("haunted.caller")

    yield load
    forget()
    cache_folder.cache_clear()


def hits(dispatcher: Any) -> int:
    return sum(dispatcher.stats.cache_hits.values())


#: What changes ``twice`` and how, and what ``twice(0)`` is then
EDITS = {
    "callee's callee": (("innermost", "x +", "x + 4 +"), 10),
    "callee": (("callee", "least(x) *", "least(x) * 2 *"), 6),
    "its constant": (("callee", "FACTOR = 1", "FACTOR = 3"), 12),
    "plain file's constant": (("sizes", "STEP = 1", "STEP = 7"), 14),
    "itself": (("caller", "step(step(x))", "step(x)"), 1),
    "how": (("callee", "()\ndef step", "(fastmath=True)\ndef step"), 2),
}

#: What leaves it as it is
ELSEWHERE = [
    ("callee", "return x\n", "return x + 1\n"),
    ("callee", "Nothing calls this.", "Still nothing."),
    ("innermost", "@compiled()\ndef", "# a comment\n@compiled()\ndef"),
    ("callee", "import compiled\n", "import compiled\nOTHER = 5\n"),
]


@pytest.mark.parametrize("edit", [edit for edit, _ in EDITS.values()], ids=EDITS)
def test_the_stamp_tells_what_a_function_is_made_of(
    load: Load, edit: tuple[str, str, str]
) -> None:
    assert content_stamp(load().twice) != content_stamp(load(edit).twice)


@pytest.mark.parametrize("edit", ELSEWHERE)
def test_the_stamp_tells_nothing_else(load: Load, edit: tuple[str, str, str]) -> None:
    assert content_stamp(load().twice) == content_stamp(load(edit).twice)


@pytest.mark.slow
@pytest.mark.parametrize("name", some(EDITS, 1))
def test_code_is_not_haunted_by_what_it_was_made_of(load: Load, name: str) -> None:
    edit, expected = EDITS[name]
    assert load().twice(0) == 2
    after = load(edit)
    assert after.twice(0) == expected
    assert hits(after.twice) == 0
    back = load()
    assert back.twice(0) == 2
    assert hits(back.twice) == 1  # both are kept


def test_swapped_fields_of_a_named_tuple_are_seen(load: Load) -> None:
    """The types of the fields are the same, and so is the function's code."""

    def first(*edits: tuple[str, str, str]) -> Any:
        caller = load(*edits)
        pair = importlib.import_module("haunted.pair").Pair
        return caller.first(pair(first=1, second=2))

    assert first() == 1
    swapped = ("pair", "first: int\n    second: int", "second: int\n    first: int")
    assert first(swapped) == 1


@pytest.mark.parametrize("edit", some(ELSEWHERE, 1))
def test_an_edit_that_does_not_reach_a_function_keeps_its_code(
    load: Load, edit: tuple[str, str, str]
) -> None:
    assert load().twice(0) == 2
    after = load(edit)
    assert after.twice(0) == 2
    assert hits(after.twice) == 1


def test_checkouts_share_code(load: Load) -> None:
    first = load()
    assert not is_kept(first.twice)
    first.twice(0)
    assert is_kept(first.twice)
    assert not is_kept(load(("callee", "FACTOR = 1", "FACTOR = 3")).twice)
    other = load(checkout="elsewhere")
    assert other.twice(0) == 2
    assert hits(other.twice) == 1


@pytest.mark.slow
def test_each_list_of_types_has_its_own_file(load: Load, tmp_path: Path) -> None:
    caller = load()
    assert (caller.twice(0), caller.twice(0.5)) == (2, 2.5)
    names = sorted(path.name for path in (tmp_path / "cache" / "ttus_opt").iterdir())
    assert sum(name.startswith("haunted.caller.twice-") for name in names) == 2
    assert not any(name.endswith(".new") for name in names)


def test_code_nobody_asks_for_is_removed(load: Load, tmp_path: Path) -> None:
    load().twice(0)
    folder = tmp_path / "cache" / "ttus_opt"
    for path in folder.iterdir():
        os.utime(path, (1.0e9, 1.0e9))
    wanted = load().twice  # from the cache: its file is of today again
    wanted(0)
    kept._remove_old.cache_clear()
    load(("caller", "step(step(x))", "step(x) + 40")).twice(0)
    left = [path.name.partition("-")[0] for path in folder.iterdir()]
    assert sorted(left) == ["haunted.callee.step"] + ["haunted.caller.twice"] * 2


def test_kept_code_is_of_today_again_where_it_is_older_than_a_day(
    tmp_path: Path,
) -> None:
    """Once a day will do: a file that is written to all the time wears a disk."""
    path, day = tmp_path / "code", 86400.0
    path.write_bytes(b"code")
    for age, renewed in ((0.5 * day, False), (2.0 * day, True), (40.0 * day, True)):
        then = time.time() - age
        os.utime(path, (then, then))
        assert kept._content_of(path) == b"code"
        assert (path.stat().st_mtime > then + 1.0) == renewed
    assert kept._content_of(tmp_path / "none") is None


def test_where_nothing_can_be_kept_nothing_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without a folder, without numba, or with a cache of numba's own."""

    def double(x: int) -> int:
        return 2 * x

    own = compiled()(double)
    assert not is_kept(own)
    assert is_kept(double) and is_kept(numba.njit(double))
    monkeypatch.setattr(kept, "cache_folder", lambda: None)
    assert is_kept(own)


@pytest.mark.slow
def test_what_another_process_compiles_is_waited_for(
    load: Load, tmp_path: Path
) -> None:
    load().twice(0)
    (code,) = (tmp_path / "cache" / "ttus_opt").glob("haunted.caller.twice-*")
    content, other = code.read_bytes(), Claims()
    other.take(code)  # as if it was at work in another process
    code.unlink()
    caller, answers = load(), list[int]()
    late = threading.Thread(target=lambda: answers.append(caller.twice(1)))
    late.start()
    late.join(0.2)
    assert late.is_alive()
    code.write_bytes(content)
    other.release()
    late.join(60.0)
    assert answers == [3]
    assert not caller.twice.stats.cache_misses
    assert not list(code.parent.glob("*.lock"))


def test_a_claim_ends_with_a_compilation_that_fails(load: Load) -> None:
    caller = load()
    with pytest.raises(numba.TypingError):
        caller.twice("no number")
    assert not caller.twice._cache.claims._held
    assert not caller.step._cache.claims._held


def test_a_stopwatch_tells_compiling_apart(load: Load) -> None:
    caller, begun = load(), time.perf_counter()
    watch = kept.Stopwatch()
    caller.twice(0)
    whole, first = time.perf_counter() - begun, watch.compile
    assert 0.0 < first < whole
    assert watch.seconds <= time.perf_counter() - begun - first
    caller.twice(0)
    assert watch.compile == first
    kept_code = load()
    kept_code.twice(0)  # read from the folder
    assert watch.compile == first


def test_a_folder_that_cannot_be_written_to_is_no_failure(
    load: Load, tmp_path: Path
) -> None:
    caller = load()
    assert cache_folder() == tmp_path / "cache" / "ttus_opt"
    (tmp_path / "cache" / "ttus_opt").rmdir()
    with pytest.warns(RuntimeWarning, match="compiled code is not saved"):
        assert caller.twice(0) == 2


def test_an_inner_function_is_called_by_compiled_ones_only() -> None:
    @compiled(inner=True)
    def half(x: float) -> float:
        return 0.5 * x

    @compiled()
    def quarter(x: float) -> float:
        return 0.5 * half(x)

    assert quarter(2.0) == 0.5
    with pytest.raises(TypeError, match="half is called by compiled functions only"):
        half(2.0)  # where numba would end the process


def test_arguments_that_lie_apart_let_a_loop_look_up_a_table(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The compiler is told so, and the two codes are not taken for each other."""

    def looked_up(table: Any, place: Any, out: Any) -> None:
        for i in range(out.size):
            out[i] = table[place[i]]

    monkeypatch.setattr(kept, "cache_folder", lambda: None)  # kept code tells no more
    arguments, said = (np.arange(5.0) ** 2, np.array([4, 0, 3, 1]), np.empty(4)), []
    pair = compiled(apart=True)(looked_up), compiled()(looked_up)
    for function in pair:
        function(*arguments)
        assert arguments[2].tolist() == [16.0, 0.0, 9.0, 1.0]
        code = next(iter(function.inspect_llvm().values()))
        said.append(re.search(r"noalias[^,]*%arg\.out\.0", code) is not None)
    assert said == [True, False]
    assert content_stamp(pair[0]) != content_stamp(pair[1])


def test_without_compilation_the_function_itself_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)

    @compiled(nogil=True)
    def square(x: float) -> float:
        return x * x

    assert type(square) is type(lambda: None)


def test_garbage_is_left_alone_while_compiling_and_not_after() -> None:
    class Watch(event.Listener):
        def on_start(self, _: event.Event) -> None:
            collected.append(gc.isenabled())

        def on_end(self, _: event.Event) -> None:
            pass

    def wrong(x: int) -> int:
        return x + "none"  # type: ignore[operator, no-any-return]

    collected: list[bool] = []
    with event.install_listener("numba:run_pass", Watch()):
        assert numba.njit(lambda x: x + 1)(1) == 2
        with pytest.raises(numba.TypingError):
            numba.njit(wrong)(1)
    assert collected and not any(collected)
    assert gc.isenabled()
