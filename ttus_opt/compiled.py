"""Compiled functions: numba with a cache that never runs outdated code.

numba keeps machine code under the content of the file a function stands in, yet links
in functions of other files: after an upgrade that changes only those, it would go on
running the old ones. Here machine code is kept under what it was made of: the function,
all compiled functions and constants it reaches in any module, the types it is called
with, the versions and the processor. An edit compiles again what it reaches and nothing
else; checkouts and environments of the same versions share what they have in common.
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

from ttus_opt.cache_folder import cache_folder
from ttus_opt.claims import Claims
from ttus_opt.content_stamp import content_stamp

# Machine code that nobody has asked for during so long is removed.
KEEP_SECONDS = 30 * 86400.0


def compiled(*, inner: bool = False, apart: bool = False, **options: Any) -> Any:
    """Decorator: compile on first use and keep the machine code.

    Args:
        inner: Called by compiled functions only, which halves the time to compile it.
        apart: No array that it writes shares memory with another argument, so that a
            loop that looks up tables can become vector instructions.
        options: numba's own (``nogil``, ``inline``, ``fastmath``, ``error_model``).

    Returns:
        A decorator like ``numba.njit``.
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
    """A compiled function without an entrance from Python: numba would crash."""

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        raise TypeError(
            f"{self.py_func.__name__} is called by compiled functions only: it is "
            "declared with inner=True"
        )


class _Apart(numba.core.dispatcher._FunctionCompiler):
    """Compiles for arguments that share no memory; numba does so for its own loops."""

    apart = True  # told in the content stamp

    def _customize_flags(self, flags: Any) -> Any:
        flags.noalias = True
        return flags


def is_kept(dispatcher: Any) -> bool:
    """Whether machine code of a compiled function as it stands is kept for any types.

    Args:
        dispatcher: The function; with NUMBA_DISABLE_JIT there is nothing to keep.
    """
    kept = getattr(dispatcher, "_cache", None)
    folder = cache_folder()
    if not isinstance(kept, _Kept) or folder is None:
        return True
    return any(folder.glob(f"{kept.name}-*"))


@functools.cache  # once in a process
def _announce() -> None:
    """Say on a terminal or in a notebook why the first call takes long."""
    if sys.stderr.isatty() or "ipykernel" in sys.modules:
        sys.stderr.write(
            "ttus_opt compiles what it uses, once on this machine: up to a minute. "
            "`ttus-opt warm-up` does all of it ahead.\n"
        )


class _Compiling(event.Listener):
    """How long numba has compiled in this process; loading of kept code is none.

    Meanwhile cyclic garbage is not collected.
    """

    def __init__(self) -> None:
        self.seconds, self._depth, self._since = 0.0, 0, 0.0
        self._collects = False

    def on_start(self, event: Any) -> None:
        """One function compiles, maybe amid another: numba lets one thread do so."""
        if self._depth == 0:
            self._since, self._collects = time.perf_counter(), gc.isenabled()
            gc.disable()  # which takes a tenth of the time to look for little
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """It is compiled, or has failed and others need not wait for it."""
        if sys.exc_info()[0] is not None:  # `event.is_failed` says the contrary
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
    """Time from its making on, with what numba compiled meanwhile told apart."""

    def __init__(self) -> None:
        self._start, self._compiled = time.perf_counter(), _COMPILING.seconds

    @property
    def compile(self) -> float:
        """Compiling, all threads together [s]."""
        return _COMPILING.seconds - self._compiled

    @property
    def seconds(self) -> float:
        """All else [s]."""
        return time.perf_counter() - self._start - self.compile


def _type_content(kind: Any) -> str:
    """A type of numba's, with the names of a named tuple's fields."""
    parts = getattr(kind, "types", None) or getattr(kind, "type", None) or ()
    parts = parts if isinstance(parts, tuple) else (parts,)
    fields = ",".join(getattr(kind, "fields", ()))
    inner = ";".join(_type_content(part) for part in parts)
    return f"{kind}<{fields}><{inner}>"


@functools.cache
def _surroundings() -> str:
    """What machine code depends on beside what it was made of."""
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
    """Machine code of one function, a file for each list of argument types.

    Processes that need the same code at once wait for the one that compiles it. None
    waits for another that waits for it: who compiles holds claims on a function and its
    callers, and waits for what it calls.

    A file is named after all it depends on and written in one step, so processes that
    compile the same side by side cannot take one for another. (numba's own index can:
    two processes that add a signature each may give both the same file.)
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
        """Nothing to do: what has changed has another name."""

    @functools.cached_property
    def _stamp(self) -> str:
        return content_stamp(self._dispatcher)  # later than the functions below it

    @property
    def name(self) -> str:
        """How the files of this function begin, as it stands now."""
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
        """The kept machine code for these types, or None."""
        target_context.refresh()
        path = self._path(sig, target_context.codegen())
        if path is None:
            return None
        content = _content_of(path)
        if content is None:
            _announce()
            self.claims.take(path)
            content = _content_of(path)  # by whoever held the claim
            if content is None:
                return None
            self.claims.release()
        payload = pickle.loads(content)
        return compiler.CompileResult._rebuild(target_context, *payload)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the machine code compiled for these types."""
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
    """Kept code, which stays for another month; None when there is none."""
    try:
        content = path.read_bytes()
        if time.time() - path.stat().st_mtime > KEEP_SECONDS / 30:
            os.utime(path)  # asked for today
    except OSError:
        return None
    return content


@functools.cache  # once in a process, and only in one that compiles
def _remove_old(folder: Path) -> None:
    """Remove what has not been asked for in a month."""
    limit = time.time() - KEEP_SECONDS
    for path in folder.iterdir():
        try:
            if path.stat().st_mtime < limit:
                path.unlink()
        except OSError:
            continue  # another process has removed it
