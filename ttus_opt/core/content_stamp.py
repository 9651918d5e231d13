"""Checksum of a compiled function and of everything it uses, in any file."""

from __future__ import annotations

import dis
import functools
import hashlib
import types
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np


def content_stamp(dispatcher: Any) -> str:
    """Checksum of a compiled function and of the functions and constants it uses.

    Returns:
        Hexadecimal digits, the same in every process and every checkout.

    Raises:
        TypeError: It reads a global whose content cannot be determined.
    """
    seen: dict[int, int] = {}
    return hashlib.sha256("\n".join(_content(dispatcher, seen)).encode()).hexdigest()


def _content(value: Any, seen: dict[int, int]) -> Iterator[str]:
    """Lines that identify a value by its content, the same in every process."""
    if isinstance(value, numba.core.dispatcher.Dispatcher | types.FunctionType):
        yield from _function_content(value, seen)
    elif isinstance(value, tuple | list):
        yield f"{type(value).__name__} of {len(value)}"
        for part in value:
            yield from _content(part, seen)
    elif isinstance(value, slice):  # a constant of functions since Python 3.14
        yield "slice"
        yield from _content((value.start, value.stop, value.step), seen)
    elif isinstance(value, dict | set | frozenset):  # sorted: no process's own order
        yield f"{type(value).__name__} of {len(value)}"
        parts = value.items() if isinstance(value, dict) else value
        yield from sorted("\n".join(_content(part, seen)) for part in parts)
    elif isinstance(value, type):
        yield f"{value.__module__}.{value.__qualname__}"
        yield from _content(getattr(value, "_fields", ()), seen)
    else:
        yield _leaf_content(value)


def _function_content(value: Any, seen: dict[int, int]) -> Iterator[str]:
    """Lines of a function, compiled or not: its code and what it uses."""
    function = getattr(value, "py_func", value)
    name = f"{function.__module__}.{function.__qualname__}"
    if function is value and function.__module__.startswith("numba."):
        yield name  # its content is determined by numba's version
        return
    if id(value) in seen:
        yield f"function {seen[id(value)]}"
        return
    seen[id(value)] = len(seen)
    yield name
    yield from _content(getattr(value, "targetoptions", None), seen)
    if getattr(getattr(value, "_compiler", None), "apart", False):
        yield "apart"
    yield from _content((function.__defaults__, function.__kwdefaults__), seen)
    for cell in function.__closure__ or ():
        yield from _content(cell.cell_contents, seen)
    code = function.__code__
    if code.co_consts[:1] == (function.__doc__,):  # a docstring changes no code
        code = code.replace(co_consts=(None, *code.co_consts[1:]))
    yield from _code_content(code, function.__globals__, seen)


def _leaf_content(value: Any) -> str:
    """One line for a value that contains no other values.

    Raises:
        TypeError: Its content cannot be determined.
    """
    if isinstance(value, np.ndarray):
        content = hashlib.sha256(value.tobytes()).hexdigest()
        return f"{value.dtype} {value.shape} {content}"
    if isinstance(value, int | float | complex | str | bytes | None | np.generic):
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, types.ModuleType):
        return f"module {value.__name__}"
    if isinstance(value, np.dtype | numba.types.Type | np.ufunc | types.EllipsisType):
        return f"{type(value).__name__} {value}"
    if callable(value) and hasattr(value, "__name__"):  # from NumPy or Python itself
        return f"{getattr(value, '__module__', None)}.{value.__name__}"
    raise TypeError(
        f"a compiled function reads a {type(value).__name__}, whose content cannot be "
        "identified: make it a number, a tuple or an array"
    )


def _code_content(
    code: types.CodeType, names: dict[str, Any], seen: dict[int, int]
) -> Iterator[str]:
    """Lines that identify what code does, independent of its file and line numbers."""
    yield hashlib.sha256(code.co_code).hexdigest()
    yield repr((code.co_varnames, code.co_names, code.co_freevars, code.co_cellvars))
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _code_content(constant, names, seen)
        else:
            yield from _content(constant, seen)
    for name, *attributes in _globals_read(code):
        value = names.get(name)  # None for a built-in: its name is in co_names above
        yield from _content(value, seen)
        for attribute in attributes:
            if not isinstance(value, types.ModuleType):
                break
            value = getattr(value, attribute)
            yield from _content(value, seen)


@functools.cache
def _globals_read(code: types.CodeType) -> tuple[tuple[str, ...], ...]:
    """The globals that code reads, each followed by the attributes read from it."""
    reads: list[list[str]] = []
    follows = False
    for step in dis.get_instructions(code):
        if step.opname == "LOAD_GLOBAL":
            reads.append([step.argval])
            follows = True
        elif follows and step.opname in ("LOAD_ATTR", "LOAD_METHOD"):
            reads[-1].append(step.argval)
        else:
            follows = False
    return tuple(dict.fromkeys(tuple(read) for read in reads))
