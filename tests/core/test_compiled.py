import contextlib
import gc
import importlib
import io
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from filelock import FileLock
from numba.core import event

from tests.kit import python, refuses, some
from ttus_opt.core import compiled as module
from ttus_opt.core.cache_folder import cache_folder
from ttus_opt.core.compiled import compiled, content_key, is_cached
from ttus_opt.core.errors import TtusWarning

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
from haunted.pair import Pair

@compiled()
def twice(x):
    return step(step(x))

@compiled()
def first(pair: Pair):
    return pair.first
""",
}

Load = Callable[..., Any]


@pytest.fixture
def load(tmp_path, monkeypatch):
    """Load the package anew, with edits, as a new process would: (file, old, new)."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # it goes by a file's second
    cache_folder.cache_clear()

    def forget():
        for name in [name for name in sys.modules if name.split(".")[0] == "haunted"]:
            del sys.modules[name]

    def load(*edits, checkout="here"):
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


def hits(dispatcher):
    return sum(dispatcher.stats.cache_hits.values())


def folders(tmp_path):
    """Functions that have machine code in the cache."""
    saved = (tmp_path / "cache" / "ttus_opt").glob("*/*.nbc")
    return sorted(path.parent.name.partition("-")[0] for path in saved)


#: What changes ``twice`` and how, and what ``twice(0)`` is then
EDITS = {
    "callee's callee": (("innermost", "x +", "x + 4 +"), 10),
    "callee": (("callee", "least(x) *", "least(x) * 2 *"), 6),
    "its constant": (("callee", "FACTOR = 1", "FACTOR = 3"), 12),
    "plain file's constant": (("sizes", "STEP = 1", "STEP = 7"), 14),
    "itself": (("caller", "step(step(x))", "step(x)"), 1),
    "how": (("callee", "()\ndef step", "(fastmath=True)\ndef step"), 2),
}


@pytest.mark.parametrize("edit", [edit for edit, _ in EDITS.values()], ids=EDITS)
def test_the_key_tells_what_a_function_is_made_of(load, edit):
    def keys(caller):
        least = caller.step.py_func.__globals__["least"]
        return content_key(caller.twice.py_func), content_key(least.py_func)

    before, after = keys(load()), keys(load(edit))
    assert before[0] != after[0]
    unseen = edit[0] in ("callee", "caller")  # which least() does not use
    assert unseen == (before[1] == after[1])


@pytest.mark.slow
@pytest.mark.parametrize("name", some(EDITS, 1))
def test_code_is_not_haunted_by_what_it_was_made_of(load, name):
    """numba's own cache goes by the caller's file: it would run the old callee."""
    edit, expected = EDITS[name]
    assert load().twice(0) == 2
    after = load(edit)
    assert after.twice(0) == expected
    assert hits(after.twice) == 0
    back = load()
    assert back.twice(0) == 2
    assert hits(back.twice) == 1  # both are kept


def test_a_callee_edited_after_it_was_loaded_is_not_taken_for_its_file(load, tmp_path):
    caller = load()
    file = tmp_path / "here" / "haunted" / "callee.py"
    time.sleep(0.01)  # a file system's clock
    file.write_text(file.read_text().replace("FACTOR = 1", "FACTOR = 3"))
    assert caller.twice(0) == 2
    assert caller.twice.folder is None
    assert "haunted.caller.twice" not in folders(tmp_path)


def test_a_constant_imported_by_value_is_part_of_the_key(load):
    """As where it depends on the machine: its file tells nothing then."""
    caller = load()
    names, keys = caller.step.py_func.__globals__, []
    for value in (1, 2, 2.0, (1, 2), ((1,), 2), np.zeros(2), np.zeros(2, np.int64)):
        names["OTHER"] = value
        keys.append(content_key(caller.twice.py_func))
    names["OTHER"] = object()  # which no compiled function can read
    assert len({*keys, content_key(caller.twice.py_func)}) == len(keys) + 1


def test_swapped_fields_of_a_named_tuple_are_seen(load):
    """The types of the fields are the same, and so is the function's code."""

    def first(*edits):
        caller = load(*edits)
        pair = importlib.import_module("haunted.pair").Pair
        return caller.first(pair(first=1, second=2))

    assert first() == 1
    swapped = ("pair", "first: int\n    second: int", "second: int\n    first: int")
    assert first(swapped) == 1
    hidden = ("caller", "from haunted.pair import Pair", "Pair = object")
    refuses(TypeError, "takes a Pair: import it in haunted", first, hidden)


def test_checkouts_share_code(load):
    first = load()
    assert not is_cached(first.twice)
    first.twice(0)
    assert is_cached(first.twice)
    assert not is_cached(load(("callee", "FACTOR = 1", "FACTOR = 3")).twice)
    other = load(checkout="elsewhere")
    assert other.twice(0) == 2
    assert hits(other.twice) == 1


KEYS = """
import importlib, pathlib, ttus_opt
from ttus_opt.core.compiled import Function, content_key
root = pathlib.Path(ttus_opt.__file__).parent
for path in sorted(root.glob("*/**/*kernels.py")):
    parts = path.relative_to(root.parent).with_suffix("").parts
    module = importlib.import_module(".".join(parts))
    for name, value in vars(module).items():
        if isinstance(value, Function):
            print(module.__name__, name, content_key(value.py_func))
"""


@pytest.mark.slow
def test_keys_are_the_same_in_all_processes():
    """The order of a set, in which options are given, is another in each."""
    own = {"PYTHONHASHSEED": "1", "PYTHONPATH": str(Path.cwd())}
    other = python("-c", KEYS, **own).stdout.splitlines()
    here = io.StringIO()
    with contextlib.redirect_stdout(here):  # as a rule with a seed of its own
        exec(KEYS, {})
    assert other == here.getvalue().splitlines()
    assert len(other) > 20


def test_code_nobody_asks_for_is_removed(load, tmp_path):
    load().twice(0)
    folder = tmp_path / "cache" / "ttus_opt"
    for path in folder.iterdir():
        os.utime(path, (1.0e9, 1.0e9))
    (folder / "of an older version").touch()
    os.utime(folder / "of an older version", (1.0e9, 1.0e9))
    wanted = load().twice  # from the cache: its folder is of today again
    wanted(0)
    assert hits(wanted) == 1
    module._remove_old.cache_clear()
    load(("caller", "step(step(x))", "step(x) + 40")).twice(0)
    assert folders(tmp_path) == ["haunted.callee.step"] + ["haunted.caller.twice"] * 2
    assert not (folder / "of an older version").exists()


def test_where_nothing_can_be_kept_nothing_is_missing(monkeypatch):
    """Without a folder, without a file, without numba, or with numba's own cache."""

    def double(x):
        return 2 * x

    names: dict[str, Any] = {"compiled": compiled, "__name__": "typed"}
    exec("@compiled()\ndef typed(x):\n    return 2 * x", names)
    assert names["typed"](2) == 4
    assert is_cached(names["typed"])
    assert not is_cached(compiled()(double))
    assert is_cached(double) and is_cached(numba.njit(double))
    monkeypatch.setattr(module, "cache_folder", lambda: None)
    assert is_cached(compiled()(double))


@pytest.mark.slow
def test_what_another_process_compiles_is_waited_for(load, tmp_path):
    load().twice(0)
    (code,) = (tmp_path / "cache" / "ttus_opt").glob("haunted.caller.twice-*/*.nbc")
    content = code.read_bytes()
    caller, answers = load(), list[int]()
    late = threading.Thread(target=lambda: answers.append(caller.twice(1)))
    with FileLock(code.parent / "lock"):  # as if it was at work in another process
        code.unlink()
        late.start()
        late.join(0.3)
        assert late.is_alive()
        code.write_bytes(content)
    late.join(60.0)
    assert answers == [3]
    assert not caller.twice.stats.cache_misses


@pytest.mark.slow
def test_processes_at_once_do_not_take_each_other_s_code(load, tmp_path):
    """numba's index alone may give two lists of types the same file."""
    load()
    script = (
        "import sys; sys.path.insert(0, sys.argv[1]); kind = eval(sys.argv[2])\n"
        "from haunted.caller import twice; print(twice(kind(1)))"
    )
    kinds = {"int": "3", "float": "3.0", "complex": "(3+0j)", "bool": "3"}
    for _ in range(2):  # compiled, then read
        running = [
            subprocess.Popen(
                [sys.executable, "-c", script, str(tmp_path / "here"), kind],
                env={
                    **os.environ,
                    "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
                    "PYTHONPATH": str(Path.cwd()),
                },
                stdout=subprocess.PIPE,
                text=True,
            )
            for kind in kinds
        ]
        said = [process.communicate()[0].strip() for process in running]
        assert said == list(kinds.values())
    assert folders(tmp_path).count("haunted.caller.twice") == len(kinds)


@pytest.mark.skipif(sys.platform == "win32", reason="modes of folders")
def test_code_an_administrator_compiled_is_read_where_nothing_can_be_written(
    load, tmp_path, monkeypatch
):
    load().twice(0)
    folder = tmp_path / "cache" / "ttus_opt"
    before = sorted(path.stat().st_mtime_ns for path in folder.rglob("*"))
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    other = load()
    assert other.twice(0) == 2
    assert hits(other.twice) == 1
    assert sorted(path.stat().st_mtime_ns for path in folder.rglob("*")) == before


def test_a_stopwatch_tells_compiling_apart(load):
    caller, begun = load(), time.perf_counter()
    watch = module.Stopwatch()
    caller.twice(0)
    whole, first = time.perf_counter() - begun, watch.compile
    assert 0.0 < first < whole
    assert watch.seconds <= time.perf_counter() - begun - first
    caller.twice(0)
    assert watch.compile == first
    kept_code = load()
    kept_code.twice(0)  # read from the folder
    assert watch.compile == first


def test_a_folder_that_cannot_be_written_to_is_no_failure(load, tmp_path):
    caller = load()
    assert cache_folder() == tmp_path / "cache" / "ttus_opt"
    (tmp_path / "cache" / "ttus_opt").rmdir()
    with pytest.warns(TtusWarning, match="compiled code is not saved"):
        assert caller.twice(0) == 2


def test_an_inner_function_is_called_by_compiled_ones_only():
    @compiled(inner=True)
    def half(x):
        return 0.5 * x

    @compiled()
    def quarter(x):
        return 0.5 * half(x)

    assert quarter(2.0) == 0.5
    with pytest.raises(TypeError, match="half is called by compiled functions only"):
        half(2.0)  # where numba would end the process


def test_arguments_that_lie_apart_let_a_loop_look_up_a_table(monkeypatch):
    """The compiler is told so."""

    def looked_up(table, place, out):
        for i in range(out.size):
            out[i] = table[place[i]]

    monkeypatch.setattr(module, "cache_folder", lambda: None)  # kept code tells no more
    arguments, said = (np.arange(5.0) ** 2, np.array([4, 0, 3, 1]), np.empty(4)), []
    pair = compiled(apart=True)(looked_up), compiled()(looked_up)
    for function in pair:
        function(*arguments)
        assert arguments[2].tolist() == [16.0, 0.0, 9.0, 1.0]
        code = next(iter(function.inspect_llvm().values()))
        said.append(re.search(r"noalias[^,]*%arg\.out\.0", code) is not None)
    assert said == [True, False]


def test_without_compilation_the_function_itself_is_left(monkeypatch):
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)

    @compiled(nogil=True)
    def square(x):
        return x * x

    assert type(square) is type(lambda: None)


def test_garbage_is_left_alone_while_compiling_and_not_after():
    class Watch(event.Listener):
        def on_start(self, _):
            collected.append(gc.isenabled())

        def on_end(self, _):
            pass

    def wrong(x):
        return x + "none"

    collected: list[bool] = []
    with event.install_listener("numba:run_pass", Watch()):
        assert numba.njit(lambda x: x + 1)(1) == 2
        with pytest.raises(numba.TypingError):
            numba.njit(wrong)(1)
    assert collected and not any(collected)
    assert gc.isenabled()
