"""Compiled functions: numba with a cache that never runs outdated code.

numba's own cache goes by the file that contains a function, although machine code also
contains functions and constants from other files: after an upgrade that changes only
those, the old code would still run. So each function has a folder of its own in the
cache, named by a hash of all sources it can be made of. What has been edited is
compiled anew; checkouts with the same sources share machine code.
"""

from __future__ import annotations

import contextlib
import enum
import functools
import gc
import hashlib
import os
import platform
import shutil
import sys
import threading
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import caching, compiler, event, sigutils
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher

from ttus_opt.core.cache_folder import cache_folder
from ttus_opt.core.errors import warn

# Machine code that has not been used for this long is removed.
KEEP_SECONDS = 30 * 86400.0

#: Values that compiled functions read as constants
CONSTANTS = (int, float, complex, str, bytes, np.generic)

_CHOOSING = threading.Lock()


def compiled(*, inner: bool = False, apart: bool = False, **options: Any) -> Any:
    """Decorator like ``numba.njit``: compile on first use and cache the machine code.

    Args:
        inner: Called by compiled functions only; this halves the compile time.
        apart: The arrays it writes share no memory with other arguments, so that loops
            with table look-ups can be vectorised.
        options: numba's own (``nogil``, ``inline``, ``fastmath``, ``error_model``).
    """
    if inner:
        options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    options |= {"nopython": True, "boundscheck": options.get("boundscheck")}
    kind = Inner if inner else Function
    pipeline = _Apart if apart else compiler.Compiler

    def decorate(function: Any) -> Any:
        if numba.config.DISABLE_JIT:
            return function
        return kind(function, targetoptions=options, pipeline_class=pipeline)

    return decorate


class Function(CPUDispatcher):
    """A compiled function; of several processes that need it at once, one compiles."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.since = time.time_ns()  # its module and what it imports are loaded

    @functools.cached_property
    def folder(self) -> Path | None:
        """Folder of its machine code, which need not exist; None if nothing is cached.

        It is chosen, and numba's cache with it, when the function is first used.
        """
        if (
            cache_folder() is None
            or not Path(self.py_func.__code__.co_filename).is_file()
        ):
            return None
        if any(_changed(names) > self.since for names in files(self.py_func)):
            return None  # edited since it was loaded: its code is another's
        with _CHOOSING:
            before = numba.config.CACHE_LOCATOR_CLASSES
            numba.config.CACHE_LOCATOR_CLASSES = f"{__name__}.FunctionFolder"
            try:
                self.enable_caching()
            finally:
                numba.config.CACHE_LOCATOR_CLASSES = before
        return Path(self.stats.cache_path)

    def compile(self, sig: Any) -> Any:
        """Machine code for these argument types, from the cache if it is there.

        The lock makes other processes wait and then read what this one has saved.
        There is no deadlock: a process holds the locks of a function and its callers,
        and waits only for those of functions they call.

        Raises:
            TypeError: It takes a named tuple that is not imported where it is defined.
        """
        known = [names["__name__"] for names in files(self.py_func)]
        for argument in sigutils.normalize_signature(sig)[0]:
            for kind in _named_tuples(argument):
                if kind.__module__ not in known:
                    raise TypeError(
                        f"{self.py_func.__name__} takes a {kind.__name__}: import it "
                        f"in {known[0]}, so that a change of its fields is seen there"
                    )
        try:
            with global_compiler_lock, _locked(self.folder):
                return super().compile(sig)
        except OSError as error:
            warn(f"compiled code is not saved: {error}")
        with contextlib.suppress(OSError):
            return super().compile(sig)  # without a lock
        return super().compile(sig)  # it was compiled, and saving failed


class Inner(Function):
    """A compiled function that Python cannot call: numba itself would crash."""

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """A call from Python.

        Raises:
            TypeError: Always.
        """
        raise TypeError(
            f"{self.py_func.__name__} is called by compiled functions only: it is "
            "declared with inner=True"
        )


class _Apart(compiler.Compiler):
    """Compile for arguments that share no memory, as numba does for its own loops."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.flags.noalias = True


@contextlib.contextmanager
def _locked(folder: Path | None) -> Iterator[None]:
    """Hold the lock of a function's folder, whose last use is now.

    A folder that only the administrator may write to needs no lock.
    """
    if folder is None or not os.access(folder.parent, os.W_OK):
        yield
        return
    from filelock import FileLock  # 14 ms, and only where something is loaded

    folder.mkdir(mode=0o755, exist_ok=True)
    if time.time() - folder.stat().st_mtime > KEEP_SECONDS / 30:
        os.utime(folder)
    with FileLock(folder / "lock"):
        yield


class FunctionFolder(caching.UserProvidedCacheLocator):
    """Where numba's cache finds the machine code of one function."""

    def __init__(self, function: Any, file: str) -> None:
        super().__init__(function, file)
        name = f"{function.__module__}.{function.__qualname__}".replace("<locals>.", "")
        name = f"{name.removeprefix('ttus_opt.')}-{content_key(function)}"
        self.folder = (cache_folder() or Path()) / name

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> FunctionFolder:
        """The folder of a function."""
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        """The folder, which need not exist yet."""
        return str(self.folder)

    def get_source_stamp(self) -> str:
        """Nothing more: the folder's name has it."""
        return ""

    def ensure_cache_path(self) -> None:
        """Create the folder before something is saved."""
        self.folder.mkdir(mode=0o755, exist_ok=True)


def content_key(function: Any) -> str:
    """Hash of all that a function's machine code can be made of.

    These are the sources and constants of its `files`, versions and settings.
    """
    digest = hashlib.sha256(_surroundings().encode())
    for names in files(function):
        digest.update(_content(names["__file__"], _changed(names)))
        for name, value in names.items():
            if isinstance(value, np.ndarray):
                digest.update(repr((name, value.dtype, value.shape)).encode())
                digest.update(value.tobytes())
            elif _is_constant(value) and not name.startswith("__"):
                digest.update(repr((name, value)).encode())
    return digest.hexdigest()[:32]


def _is_constant(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_constant, value))
    return isinstance(value, CONSTANTS)


def files(function: Any) -> list[dict[str, Any]]:
    """Namespaces of the modules that a function's machine code can be made of.

    Its own comes first. The others are those of the compiled functions, named tuples
    and modules known in it, and so on from file to file of the same package.
    """
    package = function.__module__.partition(".")[0]
    spaces = [function.__globals__]
    for names in spaces:  # which grows
        for value in list(names.values()):
            space = _space(value)
            if space is None or space["__name__"].partition(".")[0] != package:
                continue
            if isinstance(value, types.ModuleType) and "__path__" in names:
                continue  # which of its modules a package has loaded is no part of it
            if not any(space is known for known in spaces):
                spaces.append(space)
    return spaces


def _space(value: Any) -> dict[str, Any] | None:
    """Namespace of the file that machine code is made of where it uses this value."""
    if isinstance(value, types.ModuleType):
        return vars(value)
    if isinstance(value, numba.core.dispatcher.Dispatcher):
        space: dict[str, Any] = value.py_func.__globals__
        return space
    if isinstance(value, type) and issubclass(value, tuple | enum.Enum):
        return vars(sys.modules[value.__module__])
    return None


def _named_tuples(kind: Any) -> Iterator[type]:
    """Classes of the named tuples of a numba type, also inside one another."""
    if isinstance(kind, numba.types.BaseNamedTuple):
        yield kind.instance_class
    if isinstance(kind, numba.types.BaseTuple):
        for part in kind.types:
            yield from _named_tuples(part)


def _changed(names: dict[str, Any]) -> int:
    """Last change of a module's file, or of what lies under its name [ns]."""
    status = os.stat(names["__file__"])
    return max(status.st_mtime_ns, status.st_ctime_ns)


@functools.cache
def _content(path: str, _changed: int) -> bytes:
    return hashlib.sha256(Path(path).read_bytes()).digest()


@functools.cache
def _surroundings() -> str:
    """Versions and settings that machine code depends on, beside numba's own."""
    settings = numba.core.config
    return repr(
        (
            (numba.__version__, llvmlite.__version__, np.__version__),
            (sys.implementation.name, sys.version_info[:3], platform.system()),
            (settings.OPT, settings.BOUNDSCHECK, settings.DEBUGINFO_DEFAULT),
            settings.USING_SVML,
        )
    )


def is_cached(function: Any) -> bool:
    """Whether the cache holds machine code of a function's current version, any types.

    Also true where nothing is cached: with NUMBA_DISABLE_JIT or without a folder.
    """
    folder = function.folder if isinstance(function, Function) else None
    return folder is None or any(folder.glob("*.nbc"))


@functools.cache  # once in a process
def _announce() -> None:
    """Explain on a terminal or in a notebook why the first call takes long."""
    if sys.stderr.isatty() or "ipykernel" in sys.modules:
        sys.stderr.write(
            "ttus_opt compiles what it uses, once on this machine: up to a minute. "
            "`ttus-opt warm-up` does all of it ahead.\n"
        )


@functools.cache  # once in a process, and only where something is compiled
def _remove_old() -> None:
    """Remove machine code that has not been used for `KEEP_SECONDS`."""
    folder, limit = cache_folder(), time.time() - KEEP_SECONDS
    for path in folder.iterdir() if folder is not None else ():
        with contextlib.suppress(OSError):  # another process may have removed it
            if path.stat().st_mtime < limit:
                shutil.rmtree(path) if path.is_dir() else path.unlink()


class _Compiling(event.Listener):
    """Time numba has spent compiling in this process, without loading from the cache.

    Garbage collection is off while numba compiles: it takes a tenth of the time and
    frees little.
    """

    def __init__(self) -> None:
        self.seconds, self._depth, self._since = 0.0, 0, 0.0
        self._collects = False

    def on_start(self, event: Any) -> None:
        """A function is compiled, possibly inside another; only one thread compiles."""
        if self._depth == 0:
            if isinstance(event.data["dispatcher"], Function):
                _announce()
            self._since, self._collects = time.perf_counter(), gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """A function is compiled, or compiling failed."""
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._since
            if self._collects:
                gc.enable()
            _remove_old()  # what was needed now has been used


_COMPILING = _Compiling()
event.register("numba:compile", _COMPILING)


class Stopwatch:
    """Time since its creation; the time numba spent compiling is counted separately."""

    def __init__(self) -> None:
        self._start, self._compiled = time.perf_counter(), _COMPILING.seconds

    @property
    def compile(self) -> float:
        """Time spent compiling, in all threads [s]."""
        return _COMPILING.seconds - self._compiled

    @property
    def seconds(self) -> float:
        """Time spent on everything else [s]."""
        return time.perf_counter() - self._start - self.compile
