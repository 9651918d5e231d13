"""The arrays of a frame as one table of addresses and shapes.

A frame needs some forty arrays. Unpacking each as an argument takes the interpreter a
third of a microsecond, together a quarter of the frame. A table is a single array, from
which compiled code rebuilds them. Frames called from Python and from C
(`ttus_opt.haptic.c_interface`) read the same tables.

A table holds addresses: its owner must keep the arrays alive and must not replace them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import carray, config, types
from numba.core import cgutils
from numba.extending import intrinsic

from ttus_opt.core.arrays import IntArray
from ttus_opt.core.compiled import compiled
from ttus_opt.core.errors import InputError
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.wrench import FieldPair, FrameBuffers, FrameLimits, render_frame

#: Words per array in a table (address and shape); number of arrays of a frame (data
#: without its flag, buffers, limits) and of a pair of fields
WORDS = 3
N_DATA = len(FrameData._fields) - 1
N_ARRAYS = N_DATA + len(FrameBuffers._fields) + len(FrameLimits._fields)
N_FIELDS = len(FieldPair._fields)


def frame_table(
    data: FrameData, buffers: FrameBuffers, limits: FrameLimits
) -> IntArray:
    """The table of a frame's arrays except its fields, shape (WORDS·N_ARRAYS,).

    Raises:
        InputError: numba does not compile.
    """
    if config.DISABLE_JIT:  # addresses mean nothing to the interpreter
        raise InputError("a renderer is compiled code: unset NUMBA_DISABLE_JIT")
    return table_of((*data[1:], *buffers, *limits))


def table_of(arrays: tuple[np.ndarray[Any, Any], ...]) -> IntArray:
    """Addresses and shapes of n arrays, shape (WORDS·n,)."""
    rows = [(a.ctypes.data, *a.shape, *(0,) * (2 - a.ndim)) for a in arrays]
    return np.array(rows, dtype=np.int64).reshape(-1)


@intrinsic
def pointer(typing_context: Any, address: Any) -> Any:
    """An address as a pointer (compiled)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(types.int64), generate


@compiled(inline="always")
def vector(table: IntArray, k: int, kind: Any) -> Any:
    """Array k of a table, one-dimensional (compiled)."""
    return carray(pointer(table[WORDS * k]), (table[WORDS * k + 1],), kind)


@compiled(inline="always")
def matrix(table: IntArray, k: int, kind: Any) -> Any:
    """Array k of a table, two-dimensional (compiled)."""
    shape = (table[WORDS * k + 1], table[WORDS * k + 2])
    return carray(pointer(table[WORDS * k]), shape, kind)


@compiled()
def _data(trilinear: bool, table: IntArray) -> FrameData:
    """The data that a frame's table describes (compiled)."""
    real, whole = np.float64, np.int64
    return FrameData(
        trilinear,
        matrix(table, 0, real),  # points
        matrix(table, 1, real),  # lever
        vector(table, 2, real),  # reference
        vector(table, 3, whole),  # start
        matrix(table, 4, real),  # spheres
        vector(table, 5, real),  # limits
        vector(table, 6, whole),  # shape
        vector(table, 7, real),  # radius
        vector(table, 8, whole),  # nodes
        vector(table, 9, real),  # layout
        matrix(table, 10, real),  # spokes
        matrix(table, 11, real),  # ceiling
        vector(table, 12, real),  # tiles
        matrix(table, 13, real),  # place
        vector(table, 14, np.bool_),  # near
        matrix(table, 15, whole),  # node
        vector(table, 16, whole),  # touched
        vector(table, 17, real),  # depth
        matrix(table, 18, real),  # spot
        vector(table, 19, whole),  # voxel
        vector(table, 20, real),  # share
        vector(table, 21, real),  # sampled
        vector(table, 22, np.int32),  # hits
    )


@compiled()
def buffers_at(table: IntArray) -> FrameBuffers:
    """The buffers that a frame's table describes (compiled)."""
    real = np.float64
    return FrameBuffers(
        matrix(table, N_DATA, real),
        vector(table, N_DATA + 1, real),
        vector(table, N_DATA + 2, real),
        matrix(table, N_DATA + 3, real),
    )


@compiled(error_model="numpy", nogil=True)
def render_tables(
    table: IntArray, fields: IntArray, trilinear: bool, time: float, may_write: bool
) -> tuple[int, bool, int, int]:
    """Call `render_frame` with the arrays of two tables (compiled).

    Args:
        table: Result of `frame_table`.
        fields: `table_of` a `FieldPair`.
        trilinear: As in `FrameData`.
        time: As for `render_frame`.
        may_write: As for `render_frame`.

    Returns:
        As `render_frame`.
    """
    real = np.float64
    limits = FrameLimits(
        vector(table, N_DATA + 4, real), matrix(table, N_DATA + 5, real)
    )
    pair = FieldPair(
        vector(fields, 0, real),
        vector(fields, 1, real),
        vector(fields, 2, real),
        vector(fields, 3, real),
        vector(fields, 4, real),
    )
    data = _data(trilinear, table)
    buffers = buffers_at(table)
    return render_frame(buffers, time, data, pair, limits, may_write)  # type: ignore[no-any-return]
