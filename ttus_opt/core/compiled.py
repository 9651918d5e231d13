"""Compiled functions: numba with a cache that never runs outdated code.

numba's own cache depends only on the file that contains a function, although machine
code also contains functions from other files: after an upgrade that changes only those,
the old code would still run. Here the key of the cache is all that the machine code
depends on: the function, all compiled functions and constants it uses in any module,
the argument types, the versions and the processor. An edit recompiles only what uses
the edited code; checkouts and environments of the same versions share machine code.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import os
import pickle
import platform
import sys
import time
import uuid
import warnings
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import caching, compiler, event, sigutils
from numba.core.serialize import dumps

from ttus_opt.core.cache_folder import cache_folder
from ttus_opt.core.claims import Claims
from ttus_opt.core.content_stamp import content_stamp

# Machine code that has not been used for this long is removed.
KEEP_SECONDS = 30 * 86400.0


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

    def decorate(function: Any) -> Any:
        dispatcher = numba.njit(**options)(function)
        if not isinstance(dispatcher, numba.core.dispatcher.Dispatcher):
            return dispatcher  # with NUMBA_DISABLE_JIT, the function itself
        dispatcher._cache = _Kept(dispatcher)
        if apart:
            dispatcher._compiler.__class__ = _Apart
        if inner:
            dispatcher.__class__ = _Inner
        return dispatcher

    return decorate


class _Inner(numba.core.registry.CPUDispatcher):
    """A compiled function that Python cannot call: numba itself would crash."""

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        raise TypeError(
            f"{self.py_func.__name__} is called by compiled functions only: it is "
            "declared with inner=True"
        )


class _Apart(numba.core.dispatcher._FunctionCompiler):
    """Compile for arguments that share no memory, as numba does for its own loops."""

    apart = True  # part of the content stamp

    def _customize_flags(self, flags: Any) -> Any:
        flags.noalias = True
        return flags


def is_kept(dispatcher: Any) -> bool:
    """Whether the cache holds machine code of a function's current version, any types.

    Also true where nothing is cached: with NUMBA_DISABLE_JIT or without a folder.
    """
    kept = getattr(dispatcher, "_cache", None)
    folder = cache_folder()
    if not isinstance(kept, _Kept) or folder is None:
        return True
    return any(folder.glob(f"{kept.name}-*"))


@functools.cache  # once in a process
def _announce() -> None:
    """Explain on a terminal or in a notebook why the first call takes long."""
    if sys.stderr.isatty() or "ipykernel" in sys.modules:
        sys.stderr.write(
            "ttus_opt compiles what it uses, once on this machine: up to a minute. "
            "`ttus-opt warm-up` does all of it ahead.\n"
        )


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
            self._since, self._collects = time.perf_counter(), gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """It is compiled, or compiling failed and other processes need not wait."""
        if sys.exc_info()[0] is not None:  # `event.is_failed` is inverted in numba
            kept = event.data["dispatcher"]._cache
            if isinstance(kept, _Kept):
                kept.claims.release()
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._since
            if self._collects:
                gc.enable()


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


def _type_content(kind: Any) -> str:
    """Text of a numba type, including the field names of named tuples."""
    parts = getattr(kind, "types", None) or getattr(kind, "type", None) or ()
    parts = parts if isinstance(parts, tuple) else (parts,)
    fields = ",".join(getattr(kind, "fields", ()))
    inner = ";".join(_type_content(part) for part in parts)
    return f"{kind}<{fields}><{inner}>"


@functools.cache
def _surroundings() -> str:
    """Versions and settings that machine code depends on."""
    settings = numba.core.config
    return repr(
        (
            (numba.__version__, llvmlite.__version__, np.__version__),
            (sys.implementation.name, sys.version_info[:3], platform.system()),
            (settings.OPT, settings.BOUNDSCHECK, settings.DEBUGINFO_DEFAULT),
            settings.USING_SVML,
        )
    )


class _Kept(caching._Cache):
    """Cached machine code of one function, one file per list of argument types.

    Processes that need the same code at once wait for the one that compiles it. There
    is no deadlock: the compiling process holds claims on a function and its callers,
    and waits only for functions they call.

    A file is named by a checksum of all it depends on and written in one step, so
    processes that compile at the same time cannot confuse files. (With numba's own
    index they can: two processes that each add a signature may use one file for both.)
    """

    def __init__(self, dispatcher: Any) -> None:
        self._dispatcher = dispatcher
        self._enabled = True
        self.claims = Claims()

    @property
    def cache_path(self) -> str | None:
        folder = cache_folder()
        return None if folder is None else str(folder)

    def enable(self) -> None:
        self._enabled = True

    def disable(self) -> None:
        self._enabled = False

    def flush(self) -> None:
        """Nothing to do: a changed function has another file name."""

    @functools.cached_property
    def _stamp(self) -> str:
        return content_stamp(self._dispatcher)  # when the globals it uses are defined

    @property
    def name(self) -> str:
        """Beginning of the file names for the current version of this function."""
        function = self._dispatcher.py_func
        name = f"{function.__module__}.{function.__name__}".removeprefix("ttus_opt.")
        return f"{name}-{self._stamp[:32]}"

    def _path(self, signature: Any, codegen: Any) -> Path | None:
        folder = cache_folder() if self._enabled else None
        if folder is None:
            return None
        arguments, _ = sigutils.normalize_signature(signature)
        argument_types = [_type_content(kind) for kind in arguments]
        key = (argument_types, codegen.magic_tuple(), _surroundings())
        name = f"{self.name}-{hashlib.sha256(repr(key).encode()).hexdigest()[:32]}"
        return folder / name

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The cached machine code for these types, or None."""
        target_context.refresh()
        path = self._path(sig, target_context.codegen())
        if path is None:
            return None
        content = _content_of(path)
        if content is None:
            _announce()
            self.claims.take(path)
            content = _content_of(path)  # from the process that held the claim
            if content is None:
                return None
            self.claims.release()
        payload = pickle.loads(content)
        return compiler.CompileResult._rebuild(target_context, *payload)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the machine code compiled for these types."""
        try:
            self._save(sig, data)
        finally:
            self.claims.release()

    def _save(self, sig: Any, data: Any) -> None:
        path = self._path(sig, data.codegen)
        if path is None or data.lifted or data.library.has_dynamic_globals:
            return
        new = path.with_name(f"{path.name}.{uuid.uuid4().hex}.new")
        try:
            new.write_bytes(dumps(data._reduce()))
            new.replace(path)
            _remove_old(path.parent)
        except OSError as error:
            new.unlink(missing_ok=True)
            self.disable()
            warnings.warn(
                f"compiled code is not saved: {error}", RuntimeWarning, stacklevel=3
            )


def _content_of(path: Path) -> bytes | None:
    """Cached code, whose last use is updated; None if there is none."""
    try:
        content = path.read_bytes()
        if time.time() - path.stat().st_mtime > KEEP_SECONDS / 30:
            os.utime(path)
    except OSError:
        return None
    return content


@functools.cache  # once per process, and only in processes that compile
def _remove_old(folder: Path) -> None:
    """Remove files that have not been used for `KEEP_SECONDS`."""
    limit = time.time() - KEEP_SECONDS
    for path in folder.iterdir():
        try:
            if path.stat().st_mtime < limit:
                path.unlink()
        except OSError:
            continue  # another process has removed it
