"""The kernels' small parts: heap sort, room for more entries, arrays of a shell."""

import numpy as np
import pytest

from tests.kit import ellipsoid, small_scene
from ttus_opt.contact import row_kernels
from ttus_opt.contact.slip import Slip
from ttus_opt.core.compiled import compiled


@compiled()
def _sorted(keys, order, count):
    row_kernels._sort(keys, order, count)


@pytest.mark.parametrize("count", [0, 1, 2, 7, 100])
def test_heap_sort_orders_the_first_keys(count):
    rng = np.random.default_rng(count)
    keys = rng.integers(0, 1000, 100).astype(np.int32)
    order = np.full(100, -1)
    _sorted(keys, order, count)
    assert sorted(order[:count].tolist()) == list(range(count))
    assert (np.diff(keys[order[:count]]) >= 0).all()
    assert (order[count:] == -1).all()


def test_rows_go_on_where_there_was_no_room():
    """Made in many small pieces they are those made in one."""
    scene = small_scene("trilinear")
    trajectory, V = scene.trajectory, scene.n_voxels
    poses = row_kernels.Poses(trajectory.rotation, trajectory.position, Slip.none())
    given = (
        poses,
        row_kernels.shell_arrays(scene.shell),
        row_kernels.VoxmapArrays.of(scene.voxmap),
    )
    scratch = row_kernels.Scratch.of(V, len(scene.shell))
    rows, done, pieces = row_kernels.Rows.empty(len(trajectory), 8), 0, 0
    while True:
        done = row_kernels.pose_rows(done, row_kernels.TRILINEAR, *given, rows, scratch)
        if done == len(trajectory):
            break
        pieces += 1
        rows = rows.grown(3 * done, 1.0)
    used = rows.row_ptr[-1]
    assert pieces > 3
    np.testing.assert_array_equal(rows.row_ptr, scene.N.indptr)
    np.testing.assert_array_equal(rows.columns[:used], scene.N.indices)
    np.testing.assert_array_equal(rows.force[:used], scene.N.data)
    np.testing.assert_array_equal(rows.torque[:used], scene.W.data)
    assert (scratch.slot == -1).all()  # left as it was found


def test_areas_refer_to_a_square_centimetre():
    shell = ellipsoid()
    assert row_kernels.shell_arrays(
        shell
    ).areas.sum() * row_kernels.REFERENCE_AREA == pytest.approx(shell.areas.sum())
