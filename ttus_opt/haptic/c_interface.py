"""The haptic frame for a loop in C or C++: a function pointer and a context.

`Renderer.c_function` returns both. The function has the C signature of
``ttus_frame.h``, needs neither the interpreter nor the GIL, and gives the same bits as
`Renderer.render_into`. The context is a table of addresses (probe, surface, scratch)
whose memory does not move while the renderer lives. `Renderer.update` changes the field
of a running loop through it.

A frame in C never waits. It increments one counter when it begins and another when it
ends. An update sets a flag (`WAITING`), waits for the frames under way, and prepares
the new fields; frames that begin meanwhile render the old ones and do not write the
ledger. One atomic store then installs the new fields, and the old ones are kept until
no frame can read them.
"""

from __future__ import annotations

import ctypes
import functools
import math
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import carray, types
from numba.extending import intrinsic

from ttus_opt.core.arrays import IntArray
from ttus_opt.core.compiled import compiled
from ttus_opt.core.errors import TtusError
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.tables import (
    N_ARRAYS,
    N_FIELDS,
    WORDS,
    buffers_at,
    pointer,
    render_tables,
    table_of,
)
from ttus_opt.haptic.wrench import (
    TWIST,
    WRENCH,
    FieldPair,
    FrameBuffers,
    FrameLimits,
)

#: The C header that declares the function and its codes
HEADER = Path(__file__).with_name("ttus_frame.h")

#: Returned by the C function instead of a count: the probe is off the grid; or
#: `wrench.BAD_POSE`, `BAD_TWIST`, `BAD_TIME` minus one
OFF_GRID = -1

#: Words of a context: frames begun and done, 1 while an update waits, the address of
#: the fields' table, 1 for trilinear sampling, what limited the last frame; then the
#: table of the frame's arrays
BEGUN, DONE, WAITING, FIELDS, TRILINEAR, LIMIT, ARRAYS = 0, 1, 2, 3, 4, 5, 6

#: Longest wait of an update for a frame to end [s]
PATIENCE = 5.0


@dataclass(frozen=True)
class CFunction:
    """A haptic frame for C; valid while this object or its renderer lives.

    Attributes:
        function: Address of a ``ttus_frame_function``, see `HEADER`.
        context: Address of its first argument.
        renderer: The renderer, referenced to keep it alive.
    """

    function: int
    context: int
    renderer: Any = field(repr=False)

    @property
    def call(self) -> Any:
        """The function as a ctypes object, to call it from Python."""
        reals, real = ctypes.POINTER(ctypes.c_double), ctypes.c_double
        arguments = ctypes.c_void_p, reals, reals, reals, real, reals
        return ctypes.CFUNCTYPE(ctypes.c_int32, *arguments)(self.function)


class Context:
    """The memory that a C function reads, and its changes by an update.

    Args:
        data: Probe and surface; its scratch is not used.
        limits: Limits of the renderer.
        pair: The fields rendered at first.
    """

    def __init__(self, data: FrameData, limits: FrameLimits, pair: FieldPair) -> None:
        own = data.with_own_scratch()
        self._arrays = *own[1:], *FrameBuffers.empty(), *limits  # kept alive
        head = np.zeros(ARRAYS, dtype=np.int64)
        head[TRILINEAR] = own.trilinear
        self.words: IntArray = np.concatenate([head, table_of(self._arrays)])
        self._fields = table_of(pair), pair
        self.words[FIELDS] = self._fields[0].ctypes.data

    def pause(self) -> None:
        """Wait for frames under way; later ones do not write the ledger."""
        _store(self.words, WAITING, 1)
        try:
            self._let_frames_end()
        except TtusError:
            _store(self.words, WAITING, 0)
            raise

    def resume(self, pair: FieldPair) -> None:
        """Render other fields from the next frame on; after `pause`."""
        old, self._fields = self._fields, (table_of(pair), pair)
        _store(self.words, FIELDS, self._fields[0].ctypes.data)
        self._let_frames_end()  # the last that may read the old fields
        del old
        _store(self.words, WAITING, 0)

    def _let_frames_end(self) -> None:
        begun, start = _load(self.words, BEGUN), time.monotonic()
        while _load(self.words, DONE) < begun:
            if time.monotonic() - start > PATIENCE:
                raise TtusError(
                    f"a frame called from C has not ended within {PATIENCE:g} s: was "
                    "its thread stopped?"
                )
            time.sleep(1e-5)


def _word_at(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """The address of a word of an array, as generated code."""
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.gep(array.data, [arguments[1]])


@intrinsic
def _read(typing_context: Any, words: Any, place: Any) -> Any:
    """Read a word atomically, sequentially consistent (compiled)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = _word_at(context, builder, signature, arguments)
        return builder.load_atomic(word, "seq_cst", 8)

    return types.int64(words, types.int64), generate


@intrinsic
def _write(typing_context: Any, words: Any, place: Any, value: Any) -> Any:
    """Write a word atomically, sequentially consistent (compiled)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = _word_at(context, builder, signature, arguments)
        builder.store_atomic(arguments[2], word, "seq_cst", 8)
        return context.get_dummy_value()

    return types.void(words, types.int64, types.int64), generate


@compiled()
def _load(words: IntArray, place: int) -> int:
    """A word of a context (compiled)."""
    return _read(words, place)  # type: ignore[no-any-return]


@compiled()
def _store(words: IntArray, place: int, value: int) -> None:
    """Set a word of a context (compiled)."""
    _write(words, place, value)


@compiled(error_model="numpy")
def _frame(
    context: Any, rotation: Any, position: Any, twist: Any, time: float, wrench: Any
) -> int:
    """`render_frame` with the arguments of ``ttus_frame.h`` (compiled)."""
    words = carray(context, (ARRAYS + WORDS * N_ARRAYS,))
    _write(words, BEGUN, words[BEGUN] + 1)
    may_write = _read(words, WAITING) == 0
    table = words[ARRAYS:]
    buffers = buffers_at(table)
    fields = carray(pointer(_read(words, FIELDS)), (WORDS * N_FIELDS,), np.int64)
    R, at, given = carray(rotation, (3, 3)), carray(position, 3), carray(twist, 6)
    for i in range(3):
        buffers.at[i] = at[i]
        for j in range(3):
            buffers.R[i, j] = R[i, j]
    if math.isnan(time):
        for i in range(6):
            buffers.rows[TWIST, i] = given[i]
    trilinear = words[TRILINEAR] != 0
    contact, in_grid, _, limit = render_tables(
        table, fields, trilinear, time, may_write
    )
    words[LIMIT] = limit
    if contact >= 0:
        out = carray(wrench, 6)
        for i in range(6):
            out[i] = buffers.rows[WRENCH, i]
    _write(words, DONE, words[DONE] + 1)
    if contact < 0:
        return int(contact) + OFF_GRID
    return int(contact) if in_grid else OFF_GRID


@functools.cache
def frame_address() -> int:
    """Address of the C function, the same for every renderer of the process."""
    reals = types.CPointer(types.float64)
    words = types.CPointer(types.int64)
    signature = types.int32(words, reals, reals, reals, types.float64, reals)
    _KEPT.append(numba.cfunc(signature)(_entry))
    return int(_KEPT[0].address)


#: The compiled entry, kept from garbage collection
_KEPT: list[Any] = []


def _entry(
    context: Any, rotation: Any, position: Any, twist: Any, time: float, wrench: Any
) -> Any:
    """The C function: only a call, so that everything else is compiled once."""
    return _frame(context, rotation, position, twist, time, wrench)
