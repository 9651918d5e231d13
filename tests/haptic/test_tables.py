"""Tables hand over the very arrays they list, and a frame of them is the frame."""

import numba
import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, ellipsoid, refuses, small_scene
from ttus_opt.core.compiled import compiled
from ttus_opt.haptic import tables
from ttus_opt.haptic.blend import PROGRESS, settled_ledger
from ttus_opt.haptic.field_swap import RenderedField, RenderedFields
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.wrench import (
    TWIST,
    WRENCH,
    FrameBuffers,
    FrameLimits,
    render_frame,
)

SCENE = small_scene("trilinear")


@compiled()
def doubled(table, k):
    """Change array k of a table in its place."""
    values = tables.matrix(table, k, np.float64)
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            values[i, j] *= 2.0
    return values.shape


@compiled()
def summed(table, k):
    return tables.vector(table, k, np.int64).sum()


def test_a_table_lists_addresses_and_shapes():
    arrays = (np.zeros((3, 4)), np.zeros(5), np.arange(7))
    table = tables.table_of(arrays).reshape(-1, tables.WORDS)
    assert table.dtype == np.int64
    np.testing.assert_array_equal(table[:, 0], [a.ctypes.data for a in arrays])
    np.testing.assert_array_equal(table[:, 1:], [[3, 4], [5, 0], [7, 0]])


def test_compiled_code_reads_and_writes_what_is_listed():
    whole, counts = np.arange(12.0).reshape(3, 4), np.arange(7)
    table = tables.table_of((np.zeros(2), whole, counts))
    assert doubled(table, 1) == (3, 4)
    np.testing.assert_array_equal(whole, 2.0 * np.arange(12.0).reshape(3, 4))
    assert summed(table, 2) == 21


@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
def test_a_frame_s_arrays_come_out_in_their_places(sampling):
    """Name by name, by address, shape and kind: none has another's place."""
    data = FrameData.of(SCENE.voxmap, ellipsoid(), sampling)
    buffers, limits = FrameBuffers.empty(), FrameLimits(np.ones(3), np.ones((2, 2)))
    table = tables.frame_table(data, buffers, limits)
    assert len(table) == tables.WORDS * tables.N_ARRAYS
    found = tables._data(data.trilinear, table)
    assert found.trilinear == data.trilinear
    for name in FrameData._fields[1:]:
        own, there = getattr(data, name), getattr(found, name)
        assert there.dtype == own.dtype, name
        assert there.shape == own.shape, name
        assert there.ctypes.data == own.ctypes.data, name
    for name, there in zip(FrameBuffers._fields, tables.buffers_at(table), strict=True):
        own = getattr(buffers, name)
        assert (there.shape, there.ctypes.data) == (own.shape, own.ctypes.data), name


@pytest.mark.parametrize("trilinear", [False, True])
def test_a_frame_by_tables_is_the_frame_itself(trilinear):
    """Amid a swap between two fields with drags of their own."""
    rng, shape = np.random.default_rng(0), SCENE.voxmap.grid.shape
    sampling = "trilinear" if trilinear else "voxel-mean"
    fields = [
        tt.PotentialField(
            SCENE.voxmap, rng.random(shape), sampling, {"friction_coefficient": mu}
        )
        for mu in (0.1, 0.4)
    ]
    renderer = tt.Renderer(fields[0], SCENE.shell)
    ledger = settled_ledger(0.0)
    ledger[PROGRESS] = 0.3
    both = RenderedFields.of(*map(RenderedField.of, fields), ledger)
    poses = SCENE.trajectory
    wrenches = []
    for by_table in (True, False):
        data, buffers = renderer._data.with_own_scratch(), FrameBuffers.empty()
        buffers.R[:], buffers.at[:] = poses.rotation[2], poses.position[2]
        buffers.rows[TWIST] = [0.05, -0.02, 0.01, 0.3, 0.0, -0.2]
        limits = renderer._limits
        if by_table:
            table = tables.frame_table(data, buffers, limits)
            counts = tables.render_tables(table, both.table, trilinear, np.nan, False)
        else:
            counts = render_frame(buffers, np.nan, data, both.pair, limits, False)
        assert counts[0] > 0
        wrenches.append([*counts, *buffers.rows[WRENCH]])
    np.testing.assert_array_equal(*wrenches)


def test_without_a_compiler_there_is_no_table(monkeypatch):
    nothing = np.zeros(SCENE.voxmap.grid.shape)
    field = tt.PotentialField(SCENE.voxmap, nothing, "trilinear")
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    refuses(InputError, "unset NUMBA_DISABLE_JIT", tt.Renderer, field, SCENE.shell)
